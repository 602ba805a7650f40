"""Poses of markers on a robot, as a fixed camera saw them, with the positions of the joints.

`read_markers` and `write_markers` are the files, `marker_recording` the columns.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from mcpilco.recordings.reader import LogRows, read_rows
from mcpilco.recordings.recording import Samples
from mcpilco.recordings.table import write_table
from mcpilco.typing import InputError, RecordingError

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
"""what the names of a marker's columns end in: position [m], unit quaternion, in the camera"""
_MARKER = re.compile(rf"(.+)_({'|'.join(POSE)})")
Columns = Mapping[str, Float[np.ndarray, " _"]]
_UNIT = 0.05
"""how far from 1 the length of a quaternion may be; it is normalised [-]"""


@dataclass(frozen=True, eq=False)
class MarkerRecording(Samples):
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

    @cached_property
    def seen(self) -> Bool[np.ndarray, "N markers"]:
        """Which frames show which marker."""
        return np.isfinite(self.positions[..., 0])

    def columns(self) -> dict[str, Float[np.ndarray, " N"]]:
        """Named columns: what `marker_recording` reads."""
        found = {"time": self.time, **dict(zip(self.joint_names, self.q.T, strict=True))}
        for place, name in enumerate(self.marker_names):
            pose = np.concatenate([self.positions[:, place], self.quaternions[:, place]], axis=1)
            found |= dict(zip((f"{name}_{end}" for end in POSE), pose.T, strict=True))
        return found


def is_pose(column: str) -> bool:
    """True for the name of a column that is part of a marker's pose."""
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
        raise InputError(
            f"expected a column `time` [s], got {', '.join(columns)}; add or rename it."
        )
    parts = {name: _MARKER.fullmatch(name) for name in columns}
    markers = tuple(dict.fromkeys(match[1] for match in parts.values() if match))
    joints = tuple(name for name, match in parts.items() if name != "time" and not match)
    for marker in markers:
        names = [f"{marker}_{end}" for end in POSE]
        if missing := [name for name in names if name not in columns]:
            raise InputError(
                f"marker {marker} needs the columns {', '.join(names)}; {', '.join(missing)} "
                "missing."
            )
    if len(markers) < 2 or not joints:
        raise InputError(
            f"expected poses of two markers at least and a joint, got the markers "
            f"{', '.join(markers) or 'none'} and the joints {', '.join(joints) or 'none'}; a "
            "marker's columns are NAME_x, NAME_y, NAME_z, NAME_qw, NAME_qx, NAME_qy, NAME_qz."
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


def read_markers(*paths: str | Path) -> tuple[MarkerRecording, tuple[str, ...]]:
    """The recording in one file, or in one with poses and one with joints; and remarks on it.

    Each file has a column `time` [s]. A marker NAME has seven columns, NAME_x, NAME_y, NAME_z [m]
    and NAME_qw, NAME_qx, NAME_qy, NAME_qz, a unit quaternion, in the camera's frame; they are empty
    where it is not seen. All other columns are joint positions [rad or m]. Those of a second file
    are interpolated to the times of the poses, which may be fewer; a pose outside of its times is
    left out.

    Raises:
        RecordingError: a file cannot be read, or the files share no time.
        InputError: the columns are no recording.
    """
    read = [(read_rows(path), path) for path in paths]
    remarks = tuple(remark for rows, _ in read for remark in rows.remarks)
    match [(_columns(rows), path) for rows, path in read]:
        case [(columns, path)]:
            pass
        case [(first, path), (second, other)]:
            poses, joints = (first, second) if any(map(is_pose, first)) else (second, first)
            columns, outside = _joined(poses, joints, f"{path} and {other}")
            remarks += outside
        case _:
            raise InputError(f"expected one file or two, poses and joints, got {len(paths)}.")
    try:
        return marker_recording(columns), remarks
    except InputError as error:
        raise RecordingError(f"{path}: {error}") from error


def write_markers(path: str | Path, recording: MarkerRecording) -> Path:
    """Write a CSV that `read_markers` reads; the cells of a marker that is not seen are empty.

    Raises:
        RunFolderError: the file cannot be written.
    """
    return write_table(path, recording.columns())


def _columns(rows: LogRows) -> Columns:
    """All columns of a file, with its own time stamps: two files share a clock."""
    names = [name for name in rows.sources if name != "time"]
    return {"time": rows.stamps} | dict(zip(names, rows.columns(names).T, strict=True))


def _joined(poses: Columns, joints: Columns, files: str) -> tuple[Columns, tuple[str, ...]]:
    """Joints at the times of the poses, by linear interpolation."""
    mixed = [name for name in poses if name != "time" and not is_pose(name)]
    if mixed or any(map(is_pose, joints)):
        raise RecordingError(
            f"{files}: expected poses in one file and joints in the other, got both in one; name "
            "that file alone, or move the columns."
        )
    time, when = joints["time"], poses["time"]
    inside = (when >= time[0]) & (when <= time[-1])
    if not inside.any():
        raise RecordingError(
            f"{files}: the poses are from {np.nanmin(when):g} to {np.nanmax(when):g} s, the joints "
            f"from {time[0]:g} to {time[-1]:g} s; both must be stamped by one clock."
        )
    columns = {name: column[inside] for name, column in poses.items()}
    for name, column in joints.items():
        if name != "time":
            columns[name] = np.interp(columns["time"], time, column)
    remarks = () if inside.all() else (f"{(~inside).sum()} poses are outside the joints' times.",)
    return columns, remarks
