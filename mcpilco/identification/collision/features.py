"""Features that the current of a joint is linear in, and checks of the recordings for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int

from mcpilco.identification.rigid_body import RigidBody, base_parameters, random_motions
from mcpilco.kernels import Gate, HardGate, SmoothGate
from mcpilco.recordings import ArmSamples
from mcpilco.typing import InputError

CURRENT_TERMS = ("viscous", "armature", "offset")
"""of a joint, besides its dry friction: the offset is that of the sensor of the current"""
GATES: dict[str, type[Gate]] = {"hard": HardGate, "smooth": SmoothGate}
_MOTIONS = 400
"""random ones, to see which parameters a joint's force depends on"""


def quiet(
    dq: Float[np.ndarray, "*b"], speed: float, gate: Literal["hard", "smooth"] = "hard"
) -> Float[np.ndarray, "*b"]:
    """The gate a: 1 where a joint is quasi-static, 0 where it moves, thesis eq. (4.9).

    Below `speed`, sigma_v [rad/s or m/s], it is quasi-static; `gate` is 1 or 0, or exp(-(dq /
    speed)^2).
    """
    return GATES[gate].shape(torch.from_numpy(np.asarray(dq) / speed)).numpy()


@dataclass(frozen=True)
class CurrentFeatures:
    """phi of each joint, thesis eq. (4.6): currents are phi w where the joint moves.

    Differs: dry friction is (1 - a(q')) sign(q'), for the sign of a velocity that is only noise
    would add its friction to the current of a joint at rest.
    """

    body: RigidBody
    """the robot, with `CURRENT_TERMS`"""
    speed: float
    """sigma_v, below which a joint is quasi-static [rad/s or m/s]"""
    gate: Literal["hard", "smooth"] = "hard"
    """its a(q')"""

    def __post_init__(self) -> None:
        if self.body.terms != CURRENT_TERMS:
            raise InputError(
                f"the robot must have the terms {CURRENT_TERMS}, got {self.body.terms}."
            )

    @property
    def joints(self) -> int:
        """J."""
        return len(self.body.chain.bodies)

    @cached_property
    def kept(self) -> tuple[Int[np.ndarray, " p"], ...]:
        """For each joint, the parameters of the robot that its current depends on."""
        Y = self.body.regressor(*random_motions(self.body, _MOTIONS, np.random.default_rng(0)))
        return tuple(base_parameters(Y[:, j]).independent for j in range(self.joints))

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


FEWEST = 500
"""samples to learn from"""
_SHARE = 0.01
"""of the samples in which each joint must move, and must rest [-]"""
_REPEATED = 0.05
"""share of samples that may be those before once more [-]"""
_DEPENDENT = 1e-2
"""what is left of a feature, relative to its size, where it depends on the others [-]"""


def check_free(
    samples: ArmSamples, joints: Sequence[str], speed: float, rests: bool = True
) -> None:
    """Raises InputError where a model of the currents cannot be learned from these samples."""
    if len(samples) < FEWEST:
        raise InputError(
            f"currents need at least {FEWEST} samples to be learned from, got {len(samples)}; "
            "record some minutes of motions and rests."
        )
    _check_repeats(samples)
    for j, joint in enumerate(joints):
        if np.ptp(samples.i[:, j]) == 0.0:
            raise InputError(
                f"the current of {joint} is the same in all samples; log the measured current of "
                "its motor."
            )
        slow = np.abs(samples.dq[:, j]) < speed
        if slow.mean() > 1.0 - _SHARE:
            raise InputError(
                f"{joint} is slower than {speed:g} rad/s in {100 * slow.mean():.0f} % of the "
                "samples, so that its friction and inertia cannot be identified; record motions of "
                "all joints."
            )
        if rests and slow.mean() < _SHARE:
            raise InputError(
                f"{joint} rests (slower than {speed:g} rad/s) in {100 * slow.mean():.1f} % of the "
                f"samples, of which at least {100 * _SHARE:g} % are needed to learn what stuck "
                "joints do; record rests between the motions, or choose the kind PP."
            )


def _check_repeats(samples: ArmSamples) -> None:
    """Refuse a log that is faster than the robot, and repeats its samples."""
    rows = np.hstack([samples.q, samples.i])
    share = float((np.diff(rows, axis=0) == 0.0).all(axis=1).mean())
    if share > _REPEATED:
        raise InputError(
            f"{100 * share:.0f} % of the samples repeat the positions and currents of those "
            "before; log at the rate of the robot's controller, or bring the log to it with --dt."
        )


def unidentified(samples: ArmSamples, features: CurrentFeatures) -> tuple[str, ...]:
    """Features of joints that the samples do not determine, as `joint: parameter`."""
    phi = features(samples.q, samples.dq, samples.ddq)
    joints = features.body.chain.joints
    return tuple(
        f"{joints[j]}: {features.names(j)[k]}"
        for j in range(features.joints)
        for k in base_parameters(phi[j], tolerance=_DEPENDENT).dependent
    )


def about_unidentified(names: Sequence[str]) -> tuple[str, ...]:
    """Warnings that name what the motions do not determine."""
    if not names:
        return ()
    shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return (
        f"The motions do not determine {shown}: postures or motions other than those recorded "
        "may raise false alarms; move several joints at once, farther and at different speeds.",
    )
