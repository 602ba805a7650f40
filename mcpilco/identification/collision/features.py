"""What the current of a joint is linear in: the robot's regressor, and friction that moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int

from mcpilco.identification.base_parameters import base_parameters
from mcpilco.identification.rigid_body import RigidBody, motions
from mcpilco.kernels import Gate, HardGate, SmoothGate
from mcpilco.typing import InputError

TERMS = ("viscous", "armature", "offset")
"""of a joint, besides its dry friction: the offset is that of the sensor of the current"""
GATES: dict[str, type[Gate]] = {"hard": HardGate, "smooth": SmoothGate}
_MOTIONS = 400
"""random ones, to see which parameters a joint's force depends on"""


def quiet(
    dq: Float[np.ndarray, "*b"], speed: float, gate: Literal["hard", "smooth"] = "hard"
) -> Float[np.ndarray, "*b"]:
    """The gate a: 1 where a joint is quasi-static, 0 where it moves, thesis eq. (4.9).

    Args:
        dq: its velocity [rad/s or m/s].
        speed: sigma_v, below which it is quasi-static, in the same unit.
        gate: 1 or 0, or exp(-(dq / speed)^2).
    """
    return GATES[gate].shape(torch.from_numpy(np.asarray(dq) / speed)).numpy()


@dataclass(frozen=True)
class CurrentFeatures:
    """phi of each joint, thesis eq. (4.6): currents are phi w where the joint moves.

    Differs: dry friction is (1 - a(q')) sign(q'), for the sign of a velocity that is only noise
    would add its friction to the current of a joint at rest.
    """

    body: RigidBody
    """the robot, with `TERMS`"""
    speed: float
    """sigma_v, below which a joint is quasi-static [rad/s or m/s]"""
    gate: Literal["hard", "smooth"] = "hard"
    """its a(q')"""

    def __post_init__(self) -> None:
        if self.body.terms != TERMS:
            raise InputError(f"the robot must have the terms {TERMS}, got {self.body.terms}.")
        Y = self.body.regressor(*motions(self.body, _MOTIONS, np.random.default_rng(0)))
        kept = tuple(base_parameters(Y[:, j]).independent for j in range(self.joints))
        object.__setattr__(self, "_kept", kept)

    @property
    def joints(self) -> int:
        """J."""
        return len(self.body.chain.bodies)

    @property
    def kept(self) -> tuple[Int[np.ndarray, " p"], ...]:
        """For each joint, the parameters of the robot that its current can tell."""
        return self._kept  # type: ignore[attr-defined]

    def __call__(
        self,
        q: Float[np.ndarray, "N J"],
        dq: Float[np.ndarray, "N J"],
        ddq: Float[np.ndarray, "N J"],
    ) -> list[Float[np.ndarray, "N p"]]:
        """phi of each joint."""
        Y = self.body.regressor(q, dq, ddq)
        dry = (1.0 - quiet(dq, self.speed, self.gate)) * np.sign(dq)
        return [np.column_stack([Y[:, j, kept], dry[:, j]]) for j, kept in enumerate(self.kept)]

    def names(self, joint: int) -> tuple[str, ...]:
        """Of the features of a joint."""
        own = self.body.chain.bodies[joint].joint
        return (*(self.body.names[k] for k in self.kept[joint]), f"{own}_dry")
