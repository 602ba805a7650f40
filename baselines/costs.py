"""PILCO's own cost of the cart-pole, beside those of `mcpilco.policies.costs`."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.typing import InputError


@dataclass(frozen=True)
class TipDistanceCost:
    """c = 1 - exp(-d^2 / (2 width^2)), d from the pole's tip to where it is up, in [0, 1] [-].

    The tip is at (p + l sin q, -l cos q), up is (0, l), with q = 0 hanging.

    Reference: Deisenroth, Efficient Reinforcement Learning using Gaussian Processes (2010),
    on the cart-pole swing-up.
    """

    cart: int
    """which state is the cart's position p [m]"""
    angle: int
    """which state is the pole's angle q [rad]"""
    length: float = 0.5
    """l, from hinge to tip [m]"""
    width: float = 0.25
    """distance at which the cost is 1 - exp(-1/2) [m]"""

    def __post_init__(self) -> None:
        if not (self.length > 0 and self.width > 0):
            raise InputError(
                "TipDistanceCost length and width must be positive [m], "
                f"got {self.length} and {self.width}."
            )

    def widened(self, factor: float) -> TipDistanceCost:
        """The same cost, `factor` times as wide: felt from further away."""
        return dataclasses.replace(self, width=factor * self.width)

    def __call__(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"] | None = None
    ) -> Float[Tensor, "*b"]:
        """The cost of each state [-]; inputs are free."""
        q = states[..., self.angle]
        aside = states[..., self.cart] + self.length * q.sin()
        below = self.length * (1.0 + q.cos())
        return 1.0 - torch.exp(-0.5 * (aside**2 + below**2) / self.width**2)
