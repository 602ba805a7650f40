"""Actuators that answer late: which commands act in a step, and what a model learns of them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.dynamics.dynamics import regressors
from mcpilco.dynamics.features import AngleAugmentation, Inputs, States
from mcpilco.plant import Program
from mcpilco.typing import InputError

MOST = 100
"""longest delay [samples]"""
ROUNDED = 1e-6
"""part of a sample that a delay is rounded by [-]"""


@dataclass(frozen=True)
class Delay:
    """How late commands act, in sampling times: d = whole + part."""

    whole: int = 0
    """whole sampling times"""
    part: float = 0.0
    """of another one, in [0, 1)"""

    @classmethod
    def of(cls, seconds: float, dt: float) -> Delay:
        """The delay of so many seconds.

        Raises:
            InputError: it is longer than `MOST` samples.
        """
        samples = seconds / dt
        if samples > MOST:
            raise InputError(
                f"model.delay must be at most {MOST} sampling times of {dt:g} s, got {seconds:g} s."
            )
        whole = int(samples + ROUNDED)
        part = samples - whole
        return cls(whole, part if part > ROUNDED else 0.0)

    @property
    def memory(self) -> int:
        """How many past commands are on their way."""
        return self.whole + (self.part > 0.0)

    def acting(self, commands: Float[Tensor, "*b M_plus_1 U"]) -> tuple[Inputs, Inputs]:
        """The mean of the command that acts during a step, and by how much it changes in it.

        The commands are that of the step, and those before it, newest first.
        """
        new = commands[..., self.whole, :]
        if self.part == 0.0:
            return new, torch.zeros_like(new)
        old = commands[..., self.whole + 1, :]
        return (1 - self.part) * new + self.part * old, new - old


def turning_regressors(
    augmentation: AngleAugmentation,
    features: Program | None,
    states: States,
    acting: Inputs,
    turned: Inputs,
) -> Float[Tensor, "*b D"]:
    """Regressors of the GPs in a step in which two commands act: [z, mean, change, features].

    `acting` is the mean of the command in the step, `turned` by how much it changes; features are
    further regressors, of [state, mean command], of which the first U stand for the change.
    """
    asked = regressors(augmentation, features, states, acting)
    begin = augmentation.width + acting.shape[-1]
    asked[..., begin : begin + turned.shape[-1]] = turned
    return asked
