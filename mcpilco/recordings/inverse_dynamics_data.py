"""What inverse dynamics are learned from: positions, velocities, accelerations and torques."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from mcpilco.kernels import Kind
from mcpilco.typing import InputError

ARRAYS = ("q", "dq", "ddq", "tau")
"""what is measured"""
FEWEST = 25
"""rows that a joint needs at least"""
STILL = 1e-6
"""range of a channel, relative to its size or 1, below which it is constant [-]"""
REPEATED = 0.01
"""share of rows that may be equal to an earlier one [-]"""


@dataclass(frozen=True, eq=False)
class JointData:
    """N samples of a robot with J joints, in any order."""

    q: Float[np.ndarray, "N J"]
    """positions [rad or m]"""
    dq: Float[np.ndarray, "N J"]
    """velocities [rad/s or m/s]"""
    ddq: Float[np.ndarray, "N J"]
    """accelerations [rad/s^2 or m/s^2]"""
    tau: Float[np.ndarray, "N J"]
    """torques [N m], at slides forces [N]; of a robot without torque sensors motor currents [A]"""
    joints: tuple[str, ...]
    """names, in the order of the columns"""
    kinds: tuple[Kind, ...]
    """`hinge` or `slide` each"""

    def __post_init__(self) -> None:
        if len(self.joints) != len(self.kinds) or not self.joints:
            raise InputError(
                f"JointData needs a kind for each joint, got {len(self.joints)} joints and "
                f"{len(self.kinds)} kinds."
            )
        expected = (len(self.q), len(self.joints))
        for name in ARRAYS:
            shape = np.shape(getattr(self, name))
            if shape != expected:
                raise InputError(f"JointData.{name} must have the shape {expected}, got {shape}.")

    def __len__(self) -> int:
        return len(self.q)

    @property
    def motion(self) -> Float[Tensor, "N Q"]:
        """[q, q', q''], what models map to torques."""
        return torch.as_tensor(np.concatenate([self.q, self.dq, self.ddq], 1), dtype=torch.float64)

    def rows(self, index: Int[np.ndarray, " n"] | slice) -> JointData:
        """Some of the samples."""
        q, dq, ddq, tau = (getattr(self, name)[index] for name in ARRAYS)
        return JointData(q, dq, ddq, tau, self.joints, self.kinds)

    def thinned(self, most: int) -> JointData:
        """At most so many samples, at a constant step."""
        if len(self) <= most:
            return self
        return self.rows(np.linspace(0, len(self) - 1, most).round().astype(int))


def joined(parts: Sequence[JointData]) -> JointData:
    """The samples of all parts, one behind the other.

    Raises:
        InputError: there are none, or their joints differ.
    """
    if not parts:
        raise InputError("no data came; give at least one recording.")
    first = parts[0]
    for part in parts[1:]:
        if (part.joints, part.kinds) != (first.joints, first.kinds):
            raise InputError(
                f"all data must be of the joints {', '.join(first.joints)}, got "
                f"{', '.join(part.joints)}; give recordings of one robot."
            )
    q, dq, ddq, tau = (np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS)
    return JointData(q, dq, ddq, tau, first.joints, first.kinds)


def check(data: JointData) -> None:
    """Nothing, where a model can be learned from these data.

    Raises:
        InputError: a value is not finite, samples are too few or repeated, a joint stands still, or
            its torque does; the sentence says what to record instead.
    """
    _require_finite(data)
    needed = FEWEST * len(data.joints)
    if len(data) < needed:
        raise InputError(
            f"{len(data.joints)} joints need at least {needed} samples, got {len(data)}; record "
            "for longer, or at a higher rate."
        )
    table = np.concatenate([data.q, data.dq, data.ddq, data.tau], 1)
    again = len(data) - len(np.unique(table, axis=0))
    if again > REPEATED * len(data):
        raise InputError(
            f"{again} of {len(data)} samples are equal to an earlier one in all columns; give each "
            "file once, log at the rate of the sensors, and leave out where the robot rests."
        )
    _require_motion(data)


def _require_finite(data: JointData) -> None:
    for name in ARRAYS:
        array = getattr(data, name)
        if not np.isfinite(array).all():
            row, joint = np.argwhere(~np.isfinite(array))[0]
            raise InputError(
                f"{name} of joint {data.joints[joint]!r} must be finite, got {array[row, joint]} "
                f"in row {row}; leave that row out."
            )


def _require_motion(data: JointData) -> None:
    for j, joint in enumerate(data.joints):
        for what, array in (("position", data.q), ("torque", data.tau)):
            column = array[:, j]
            size = max(1.0, float(np.abs(column).max())) if what == "position" else 1.0
            if np.ptp(column) <= STILL * size:
                raise InputError(
                    f"the {what} of joint {joint!r} is constant ({column[0]:g}); record motions "
                    "that move every joint, all at once, or fix the joint in your description of "
                    "the robot and leave its columns out."
                )
