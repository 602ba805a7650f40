"""What models and policies see of a state."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.typing import InputError


class AngleAugmentation:
    """States with each angle replaced by its cosine and sine, so that full turns look alike.

        z = [plain entries in order, cos(angles), sin(angles)]

    Args:
        state_dim: X, the width of a state.
        angles: which entries of a state are angles [rad].

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

    def __call__(self, states: Float[Tensor, "*b X"]) -> Float[Tensor, "*b Z"]:
        """The augmented state z."""
        angles = states[..., self.angles]
        return torch.cat([states[..., self.plain], angles.cos(), angles.sin()], -1)

    def regressors(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b D"]:
        """What the GPs regress on: [z, u]."""
        return torch.cat([self(states), inputs], -1)
