"""Poses of markers on a robot, as a fixed camera saw them, with the positions of the joints."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from mcpilco.typing import InputError

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""what the names of a marker's columns end in: position [m], unit quaternion, in the camera"""
_MARKER = re.compile(rf"(.+)_({'|'.join(POSE)})")
_UNIT = 0.05
"""how far from 1 the length of a quaternion may be; it is normalised [-]"""


@dataclass(frozen=True, eq=False)
class MarkerRecording:
    """N frames of a camera. A marker that a frame does not show has NaN for its pose."""

    time: Float[np.ndarray, " N"]
    """of the frames [s]"""
    q: Float[np.ndarray, "N J"]
    """joint positions [rad or m]"""
    positions: Float[np.ndarray, "N markers 3"]
    """of the markers in the camera's frame [m]"""
    quaternions: Float[np.ndarray, "N markers 4"]
    """orientations in the camera's frame, w x y z, of length 1"""
    joint_names: tuple[str, ...]
    marker_names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.time)

    @cached_property
    def seen(self) -> Bool[np.ndarray, "N markers"]:
        """Which frames show which marker."""
        return np.isfinite(self.positions[..., 0])

    def rows(self, rows: Int[np.ndarray, " rows"]) -> MarkerRecording:
        """Some of the frames."""
        return MarkerRecording(
            self.time[rows],
            self.q[rows],
            self.positions[rows],
            self.quaternions[rows],
            self.joint_names,
            self.marker_names,
        )

    def columns(self) -> dict[str, Float[np.ndarray, " N"]]:
        """Named columns: what `marker_recording` reads."""
        found = {"time": self.time, **dict(zip(self.joint_names, self.q.T, strict=True))}
        for place, name in enumerate(self.marker_names):
            pose = np.concatenate([self.positions[:, place], self.quaternions[:, place]], axis=1)
            found |= dict(zip((f"{name}_{end}" for end in POSE), pose.T, strict=True))
        return found


def is_pose(column: str) -> bool:
    """Whether a column of this name is part of a marker's pose."""
    return _MARKER.fullmatch(column) is not None


def rotation(quaternions: Float[np.ndarray, "N 4"]) -> Rotation:
    """N rotations of quaternions w x y z."""
    return Rotation.from_quat(quaternions, scalar_first=True)


def marker_recording(columns: Mapping[str, Float[np.ndarray, " N"]]) -> MarkerRecording:
    """The recording in named columns: `time`, seven a marker (`POSE`), all others are joints.

    Raises:
        InputError: a column is missing, or holds what is no time, pose or joint position.
    """
    if "time" not in columns:
        raise InputError(f"expected a column `time` [s], got {_listed(columns)}; add or rename it.")
    parts = {name: _MARKER.fullmatch(name) for name in columns}
    markers = tuple(dict.fromkeys(match[1] for match in parts.values() if match))
    joints = tuple(name for name, match in parts.items() if name != "time" and not match)
    for marker in markers:
        missing = [end for end in POSE if f"{marker}_{end}" not in columns]
        if missing:
            raise InputError(
                f"marker {marker} needs the columns {_listed(f'{marker}_{e}' for e in POSE)}; "
                f"{_listed(f'{marker}_{end}' for end in missing)} missing."
            )
    if len(markers) < 2 or not joints:
        raise InputError(
            f"expected poses of two markers at least and a joint, got the markers "
            f"{_listed(markers) or 'none'} and the joints {_listed(joints) or 'none'}; a marker's "
            f"columns are NAME_x, NAME_y, NAME_z, NAME_qw, NAME_qx, NAME_qy, NAME_qz."
        )
    poses = np.stack(
        [np.stack([columns[f"{marker}_{end}"] for end in POSE], -1) for marker in markers], 1
    )
    for place, marker in enumerate(markers):
        poses[:, place] = _checked_pose(marker, poses[:, place])
    q = np.stack([columns[joint] for joint in joints], -1)
    _require_finite("time", columns["time"])
    for name, column in zip(joints, q.T, strict=True):
        _require_finite(name, column)
    return MarkerRecording(columns["time"], q, poses[..., :3], poses[..., 3:], joints, markers)


def _checked_pose(marker: str, pose: Float[np.ndarray, "N 7"]) -> Float[np.ndarray, "N 7"]:
    """The pose with a quaternion of length 1; all NaN where any of it is missing is an error."""
    given = np.isfinite(pose)
    partly = np.flatnonzero(given.any(1) & ~given.all(1))
    if len(partly):
        raise InputError(
            f"marker {marker}, sample {partly[0]}: expected all seven numbers of a pose or none, "
            f"got {pose[partly[0]].tolist()}; empty all seven where the marker was not seen."
        )
    length = np.linalg.norm(pose[:, 3:], axis=1)
    wrong = np.flatnonzero(np.abs(length - 1.0) > _UNIT)
    if len(wrong):
        raise InputError(
            f"marker {marker}, sample {wrong[0]}: expected a quaternion of length 1, got "
            f"{pose[wrong[0], 3:].tolist()} of length {length[wrong[0]]:.3g}; orientations are "
            "unit quaternions, w first."
        )
    return np.concatenate([pose[:, :3], pose[:, 3:] / length[:, None]], axis=1)


def _require_finite(name: str, column: Float[np.ndarray, " N"]) -> None:
    missing = np.flatnonzero(~np.isfinite(column))
    if len(missing):
        raise InputError(
            f"{name}, sample {missing[0]}: expected a number, got {column[missing[0]]}; remove the "
            f"{len(missing)} samples without one (a marker that is not seen may be left empty)."
        )


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names)
