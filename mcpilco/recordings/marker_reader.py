"""Files of marker poses and joint positions."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mcpilco.files import write_bytes
from mcpilco.recordings.markers import (
    MarkerRecording,
    is_pose,
    marker_recording,
)
from mcpilco.recordings.table import read_table
from mcpilco.typing import InputError, RecordingError

Columns = dict[str, Float[np.ndarray, " _"]]


def read_markers(*paths: str | Path) -> tuple[MarkerRecording, tuple[str, ...]]:
    """The recording in one file, or in one with poses and one with joints; and remarks on it.

    Each file has a column `time` [s]. A marker NAME has seven columns, NAME_x, NAME_y, NAME_z [m]
    and NAME_qw, NAME_qx, NAME_qy, NAME_qz, a unit quaternion, in the camera's frame; they are empty
    where it is not seen. All other columns are joint positions [rad or m]. Those of a second file
    are interpolated to the times of the poses, which may be fewer; a pose outside of its times is
    left out.

    Args:
        paths: CSV, npz or parquet, one or two.

    Raises:
        RecordingError: a file cannot be read, or the files share no time.
        InputError: the columns are no recording.
    """
    match [(_columns(path), path) for path in paths]:
        case [(columns, path)]:
            remarks: tuple[str, ...] = ()
        case [(first, path), (second, other)]:
            poses, joints = (first, second) if any(map(is_pose, first)) else (second, first)
            columns, remarks = _joined(poses, joints, f"{path} and {other}")
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
    columns = recording.columns()
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    table = np.column_stack(list(columns.values())).tolist()
    writer.writerows([["" if v != v else repr(v) for v in row] for row in table])
    return write_bytes(Path(path), text.getvalue().encode())


def _columns(path: str | Path) -> Columns:
    table = read_table(path)
    return {name: table.numbers(name) for name in table.columns}


def _joined(
    poses: Mapping[str, Float[np.ndarray, " _"]],
    joints: Mapping[str, Float[np.ndarray, " _"]],
    files: str,
) -> tuple[Columns, tuple[str, ...]]:
    """Joints at the times of the poses, by linear interpolation."""
    for columns, kind in ((poses, "poses"), (joints, "joints")):
        if "time" not in columns:
            raise RecordingError(f"{files}: the file of {kind} has no column `time`; add it [s].")
    mixed = [name for name in poses if name != "time" and not is_pose(name)]
    if mixed or any(map(is_pose, joints)):
        raise RecordingError(
            f"{files}: expected poses in one file and joints in the other, got both in one; name "
            "that file alone, or move the columns."
        )
    time, when = joints["time"], poses["time"]
    if not np.isfinite(time).all() or (np.diff(time) <= 0).any():
        raise RecordingError(f"{files}: the time of the joints must rise; sort and mend its rows.")
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
