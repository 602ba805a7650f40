"""From recordings of a robot to the samples that its inverse dynamics are learned from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mcpilco.kernels import Kind
from mcpilco.recordings import Recording, read_recordings, smoothed
from mcpilco.recordings.inverse_dynamics_data import JointData
from mcpilco.recordings.table import read_table
from mcpilco.typing import InputError, RecordingError

POSITION, VELOCITY, ACCELERATION, TORQUE = "_position", "_velocity", "_acceleration", "_torque"
"""what columns are called behind the name of their joint"""
LETTERS: Mapping[str, Kind] = {"R": "hinge", "P": "slide"}
"""kinds of joints as robots are named: revolute and prismatic"""


def kinds_of(letters: str) -> tuple[Kind, ...]:
    """The kinds of joints that `RRPR` and the like say.

    Raises:
        InputError: another letter, or none.
    """
    if not letters or set(letters.upper()) - set(LETTERS):
        raise InputError(
            "joints must be a letter for each joint, R for one that turns and P for one that "
            f"slides, as in RRPR, got {letters!r}."
        )
    return tuple(LETTERS[letter] for letter in letters.upper())


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
    `<joint>_velocity` and `<joint>_acceleration` may be absent.

    Args:
        paths: of the files.
        joints: names.
        columns: the files' names of columns, where they differ.
        dt: step to which all are brought [s]; each its own when None.

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
    return data.rows(slice(0, first)), data.rows(slice(first, None))
