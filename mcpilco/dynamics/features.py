"""The state as models and policies take it: angles as sine and cosine."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.config import FITTED_TURN_OVER
from mcpilco.plant import CoulombFriction, ViscousFriction
from mcpilco.typing import InputError

States = Float[Tensor, "*b X"]
"""of a batch, each entry in its unit"""
Inputs = Float[Tensor, "*b U"]
"""of a batch, each entry in its unit"""


def friction(dq: Float[Tensor, "*b J"]) -> Float[Tensor, "*b J 2"]:
    """The regressors of viscous and Coulomb friction of each joint: [q', tanh(q' / v_r)]."""
    viscous = ViscousFriction.force(0.0, dq, -1.0)
    return torch.stack([viscous, CoulombFriction.force(0.0, dq, -1.0, FITTED_TURN_OVER)], -1)


class JointPolynomials:
    """Motions of a robot's joints in coordinates in which all forces are polynomials.

        z = [cos(hinges), sin(hinges), slides, q'_i q'_j for i <= j, q'']

    Each of the J joints is a `hinge` or a `slide`.

    Reference: thesis eq. (3.8).
    """

    def __init__(self, kinds: Sequence[Literal["hinge", "slide"]]) -> None:
        J = len(kinds)
        self.joints = J
        self.hinges = [j for j, kind in enumerate(kinds) if kind == "hinge"]
        self.slides = [j for j, kind in enumerate(kinds) if kind == "slide"]
        self._pairs = torch.triu_indices(J, J)
        self.width = J + len(self.hinges) + self._pairs.shape[1] + J
        """D"""

    def __call__(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b D"]:
        """z of [q, q', q''] [rad or m, and their derivatives by s]."""
        q, dq, ddq = motion.split(self.joints, -1)
        angles = q[..., self.hinges]
        products = dq[..., self._pairs[0]] * dq[..., self._pairs[1]]
        return torch.cat([angles.cos(), angles.sin(), q[..., self.slides], products, ddq], -1)


class AngleAugmentation:
    """States with each angle replaced by its cosine and sine, so that full turns look alike.

        z = [plain entries in order, cos(angles), sin(angles)]

    Reference: thesis section 5.4.3.
    """

    def __init__(self, state_dim: int, angles: Sequence[int]) -> None:
        angles = tuple(angles)
        if len(set(angles)) != len(angles) or any(not 0 <= i < state_dim for i in angles):
            raise InputError(
                f"angles must be different indices within 0..{state_dim - 1}, got {angles}."
            )
        self.state_dim = state_dim
        self.angles = angles
        self.plain = tuple(i for i in range(state_dim) if i not in angles)
        """which entries are no angles"""
        self.width = state_dim + len(angles)
        """Z"""

    def __call__(self, states: States) -> Float[Tensor, "*b Z"]:
        """The augmented state z."""
        angles = states[..., self.angles]
        return torch.cat([states[..., self.plain], angles.cos(), angles.sin()], -1)

    def regressors(self, states: States, inputs: Inputs) -> Float[Tensor, "*b D"]:
        """Regressors of the GPs: [z, u]."""
        return torch.cat([self(states), inputs], -1)
