"""Positions, velocities, accelerations and torques of a robot: the data of inverse dynamics."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.kernels import Kind
from mcpilco.recordings.reader import read_recordings
from mcpilco.recordings.recording import Recording, Samples
from mcpilco.recordings.smoothing import smoothed
from mcpilco.recordings.table import read_table
from mcpilco.typing import InputError, RecordingError

ARRAYS = ("q", "dq", "ddq", "tau")
"""what is measured"""
FEWEST = 25
"""rows that a joint needs at least"""
STILL = 1e-6
"""range of a channel, relative to its size or 1, below which it is constant [-]"""
REPEATED = 0.01
"""share of rows that may be equal to an earlier one [-]"""


@dataclass(frozen=True, eq=False)
class JointData(Samples):
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

    @property
    def motion(self) -> Float[Tensor, "N Q"]:
        """[q, q', q''], what models map to torques."""
        return torch.as_tensor(np.concatenate([self.q, self.dq, self.ddq], 1), dtype=torch.float64)

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
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
        return super().joined(parts)


def check_joint_data(data: JointData) -> None:
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


POSITION, VELOCITY, ACCELERATION, TORQUE = "_position", "_velocity", "_acceleration", "_torque"
"""what columns are called behind the name of their joint"""
_KINDS: Mapping[str, Kind] = {"H": "hinge", "R": "hinge", "S": "slide", "P": "slide"}
"""by the initial; revolute and prismatic joints are hinges and slides"""


def kinds_of(names: Iterable[str]) -> tuple[Kind, ...]:
    """Kinds of joints as people and older files name them: `HHSH`, `RRPR`, or words.

    Names are hinge or revolute, slide or prismatic, or their initials, one for each joint.

    Raises:
        InputError: another name, or none.
    """
    words = [name.upper() for name in names]
    known = {"HINGE", "REVOLUTE", "SLIDE", "PRISMATIC", *_KINDS}
    if not words or set(words) - known:
        raise InputError(
            "joints must be a letter for each joint, H for a hinge and S for a slide, as in HHSH "
            f"(R and P are understood too), got {names!r}."
        )
    return tuple(_KINDS[word[0]] for word in words)


def joints_in(path: str | Path) -> tuple[str, ...]:
    """Names of the joints that have a position in a log file, in the order of its columns.

    Raises:
        RecordingError: the file cannot be read, or has no column `<joint>_position`.
    """
    columns = read_table(path).columns
    found = tuple(name.removesuffix(POSITION) for name in columns if name.endswith(POSITION))
    if not found:
        raise RecordingError(
            f"{path}: expected a column <joint>{POSITION} for each joint, got "
            f"{', '.join(columns)}; rename them."
        )
    return found


def read_joint_recordings(
    paths: Sequence[str | Path],
    joints: Sequence[str],
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
) -> list[Recording]:
    """Recordings of a robot, all of which must be readable.

    Each has the columns `time` [s] and, for each joint, `<joint>_position` and `<joint>_torque`;
    `<joint>_velocity` and `<joint>_acceleration` may be absent, and `<joint>_effort`, as ROS calls
    it, is read for a torque that the file lacks.

    `columns` are the files' names of columns, where they differ; all are brought to the step dt
    [s], by default each to its own.

    Raises:
        RecordingError: a file cannot be read.
    """
    J = len(joints)
    states = [joint + what for what in (POSITION, VELOCITY, ACCELERATION) for joint in joints]
    good, bad = read_recordings(
        paths,
        states,
        [joint + TORQUE for joint in joints],
        velocities=[(k, k + J) for k in range(2 * J)],
        columns=columns,
        dt=dt,
    )
    if bad:
        raise bad[0]
    return good


def joint_data(recording: Recording, joints: Sequence[str], kinds: Sequence[Kind]) -> JointData:
    """Samples of a recording of `read_joint_recordings`, smoothed, without those in gaps.

    Positions, velocities and accelerations are those of local cubics. A velocity without a column
    is the slope of the positions, an acceleration that of the velocities. Torques stay as they are.
    """
    J = len(joints)
    states, _ = smoothed(recording)
    if np.isnan(states[:, 2 * J :]).all(0).any():  # neither accelerations nor velocities are logged
        with_velocities = recording.states.copy()
        absent = ~np.isfinite(with_velocities).any(0)
        absent[2 * J :] = False
        with_velocities[:, absent] = states[:, absent]
        states[:, 2 * J :] = smoothed(replace(recording, states=with_velocities))[0][:, 2 * J :]
    whole = np.isfinite(states).all(1) & np.isfinite(recording.inputs).all(1)
    q, dq, ddq = np.split(states[whole], 3, axis=1)
    return JointData(q, dq, ddq, recording.inputs[whole], tuple(joints), tuple(kinds))


def held_out(data: JointData, share: float) -> tuple[JointData, JointData]:
    """The beginning and the end of a recording: to learn from, and to test on.

    Neighbouring samples are alike, so a test on some of them would say little.

    Raises:
        InputError: the share is not between 0 and 1.
    """
    if not 0.0 < share < 1.0:
        raise InputError(f"the held-out share must be between 0 and 1, got {share}.")
    first = len(data) - max(1, round(share * len(data)))
    return data[:first], data[first:]
