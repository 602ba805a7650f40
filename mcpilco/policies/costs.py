"""Costs: what is minimised, in torch; an environment's reward is exactly 1 - cost."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.typing import Cost, InputError


@dataclass(frozen=True)
class SaturatingCost:
    """c = 1 - exp(-sum_i ((s_i - target_i) / lengthscale_i)^2), from 0 to 1 [-].

    s_i is a component of the state, or its absolute value where `magnitude` says so: an angle that
    may end at +pi or at -pi has the target pi and the magnitude flag.

    Reference: thesis section 5.5.1 (the cart-pole's cost, `cart_pole_cost`).
    """

    components: tuple[int, ...]
    """which states count"""
    targets: tuple[float, ...]
    """where the cost is 0, in the state's unit"""
    lengthscales: tuple[float, ...]
    """distance at which the cost is 1 - 1/e, in the state's unit"""
    magnitude: tuple[bool, ...]
    """compare the absolute value of the state"""

    def __post_init__(self) -> None:
        entries = self.components, self.targets, self.lengthscales, self.magnitude
        if len(set(map(len, entries))) != 1:
            raise InputError(
                "SaturatingCost needs one target, lengthscale and magnitude flag for each "
                f"component, got {self.components}, {self.targets}, {self.lengthscales}, "
                f"{self.magnitude}."
            )
        if not all(scale > 0 for scale in self.lengthscales):
            raise InputError(
                f"SaturatingCost lengthscales must be positive, got {self.lengthscales}."
            )

    def widened(self, factor: float) -> SaturatingCost:
        """The same cost with lengthscales `factor` times as large: felt from further away."""
        scales = tuple(factor * scale for scale in self.lengthscales)
        return dataclasses.replace(self, lengthscales=scales)

    def __call__(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"] | None = None
    ) -> Float[Tensor, "*b"]:
        """The cost of each state [-]; inputs are free."""
        distance = states.new_zeros(states.shape[:-1])
        for i, target, scale, magnitude in zip(
            self.components, self.targets, self.lengthscales, self.magnitude, strict=True
        ):
            value = states[..., i].abs() if magnitude else states[..., i]
            distance = distance + ((value - target) / scale) ** 2
        return 1.0 - torch.exp(-distance)


@dataclass(frozen=True)
class TipCost:
    """c = 1 - exp(-|p - p*|^2 / l^2 - (x / l_x)^2), from 0 to 1 [-]: links balanced upright.

    p is the tip of a chain of links relative to its foot, p* the same when all stand upright, where
    their angles are 0; full turns look alike. x is the foot's position, where it moves.

    Reference: Deisenroth, Fox and Rasmussen, PAMI 37 (2), 2015 (PILCO's cost).
    """

    angles: tuple[int, ...]
    """which states are the links' angles, each relative to the link before it [rad]"""
    lengths: tuple[float, ...]
    """of the links [m]"""
    lengthscale: float
    """l, distance of the tip at which the cost is 1 - 1/e [m]"""
    foot: int | None = None
    """which state is the foot's position [m]; None: it is fixed"""
    foot_lengthscale: float = 1.0
    """l_x [m]"""

    def __post_init__(self) -> None:
        if not self.angles or len(self.angles) != len(self.lengths):
            raise InputError(
                "TipCost needs a length for each angle, "
                f"got angles {self.angles} and lengths {self.lengths}."
            )
        if not all(x > 0 for x in (*self.lengths, self.lengthscale, self.foot_lengthscale)):
            raise InputError(
                f"TipCost lengths and lengthscales must be positive, got {self.lengths}, "
                f"{self.lengthscale} and {self.foot_lengthscale}."
            )

    def widened(self, factor: float) -> TipCost:
        """The same cost with lengthscales `factor` times as large: felt from further away."""
        wider, foot = factor * self.lengthscale, factor * self.foot_lengthscale
        return dataclasses.replace(self, lengthscale=wider, foot_lengthscale=foot)

    def __call__(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"] | None = None
    ) -> Float[Tensor, "*b"]:
        """The cost of each state [-]; inputs are free."""
        lengths = states.new_tensor(self.lengths)
        absolute = states[..., self.angles].cumsum(-1)
        aside, height = (absolute.sin() * lengths).sum(-1), (absolute.cos() * lengths).sum(-1)
        distance = (aside**2 + (height - lengths.sum()) ** 2) / self.lengthscale**2
        if self.foot is not None:
            distance = distance + (states[..., self.foot] / self.foot_lengthscale) ** 2
        return 1.0 - torch.exp(-distance)


@dataclass(frozen=True)
class QuadraticCost:
    """c = sum_i q_i (x_i - target_i)^2 + sum_j r_j u_j^2 [-], a linear-quadratic regulator's."""

    targets: tuple[float, ...]
    """desired state"""
    state_weights: tuple[float, ...]
    """q, one for each state, 1 / unit^2"""
    input_weights: tuple[float, ...]
    """r, one for each input, 1 / unit^2"""

    def __post_init__(self) -> None:
        if len(self.targets) != len(self.state_weights):
            raise InputError(
                f"QuadraticCost needs one state weight for each of {len(self.targets)} targets, "
                f"got {len(self.state_weights)}."
            )
        if not all(weight >= 0 for weight in (*self.state_weights, *self.input_weights)):
            raise InputError(
                "QuadraticCost weights must not be negative, "
                f"got {self.state_weights} and {self.input_weights}."
            )

    def __call__(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b"]:
        """The cost of each state and input [-]."""
        error = states - states.new_tensor(self.targets)
        effort = inputs**2 @ inputs.new_tensor(self.input_weights)
        return error**2 @ states.new_tensor(self.state_weights) + effort


def costs_along(
    cost: Cost, states: Float[np.ndarray, "T X"], inputs: Float[np.ndarray, "T U"]
) -> Float[np.ndarray, " T"]:
    """The cost of each state and the input that led to it [-]."""
    with torch.no_grad():
        return cost(torch.from_numpy(states), torch.from_numpy(inputs)).numpy()


def held(values: Float[np.ndarray, " T"], steps: int) -> Float[np.ndarray, " steps"]:
    """The values, the last one repeated up to `steps`: for an episode that ended early."""
    return np.concatenate([values, np.full(steps - len(values), values[-1])])


def cart_pole_cost(cart_lengthscale: float = 1.5, angle_lengthscale: float = 1.0) -> SaturatingCost:
    """The cost of the cart-pole swing-up on the state [q1, q1', q2, q2'], q2 = 0 hanging.

    l1 is 1.5 m in the thesis, 1 m in the authors' later setting; l2 is 1 rad in the thesis, 3 rad
    later.

    Reference: thesis section 5.5.1.
    """
    scales = cart_lengthscale, angle_lengthscale
    return SaturatingCost((0, 2), (0.0, math.pi), scales, (False, True))
