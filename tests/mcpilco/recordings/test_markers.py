"""Columns and files become recordings, or sentences that say what is wrong with them."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from mcpilco.recordings import marker_recording, read_markers, write_markers
from mcpilco.typing import InputError, McPilcoError
from tests.mcpilco.identification.kinematics.robots import recorded


def write(path: Path, columns: Mapping[str, np.ndarray]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for row in zip(*(column.tolist() for column in columns.values()), strict=True):
            writer.writerow(["" if value != value else repr(value) for value in row])
    return path


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    return recorded(0, joints=2, samples=12)[1].columns()


def test_what_is_written_is_read(tmp_path: Path, columns) -> None:
    for end in ("x", "y", "z", "qw", "qx", "qy", "qz"):
        columns[f"m1_{end}"][3] = np.nan  # not seen
    path = write_markers(tmp_path / "arm.csv", marker_recording(columns))
    read, remarks = read_markers(path)
    assert not remarks
    for name, column in read.columns().items():
        np.testing.assert_allclose(column, columns[name], rtol=1e-14)
    assert read.seen.sum(0).tolist() == [12, 11, 12]


def test_joints_of_a_second_file_are_interpolated_to_the_poses(tmp_path: Path, columns) -> None:
    poses = {name: c for name, c in columns.items() if not name.startswith("q")}
    time = np.linspace(columns["time"][2], columns["time"][-1], 400)
    fast = {"time": time, "q1": 2 * time + 1, "q2": -time}
    files = write(tmp_path / "poses.csv", poses), write(tmp_path / "joints.csv", fast)
    for order in (files, files[::-1]):
        read, remarks = read_markers(*order)
        np.testing.assert_allclose(read.q[:, 0], 2 * read.time + 1, rtol=1e-12)
        assert len(read) == 10
        assert "2 poses are outside" in remarks[0]


def without(name):
    return lambda columns: {key: value for key, value in columns.items() if key != name}


def with_value(name, value):
    def change(columns):
        columns[name][5] = value
        return columns

    return change


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (without("time"), "expected a column `time`"),
        (without("m1_qz"), "marker m1 needs the columns .*; m1_qz missing"),
        (
            with_value("q1", np.nan),
            "q1, sample 5: expected a number, got nan; remove the 1 samples",
        ),
        (with_value("m1_x", np.nan), "marker m1, sample 5: expected all seven numbers"),
        (with_value("m1_qw", 7.0), "marker m1, sample 5: expected a quaternion of length 1"),
        (lambda c: {k: v for k, v in c.items() if k in ("time", "q1")}, "two markers at least"),
    ],
)
def test_bad_columns_are_named(columns, change, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        marker_recording(change(columns))


def test_files_that_share_no_time_are_refused(tmp_path: Path, columns) -> None:
    poses = {name: c for name, c in columns.items() if not name.startswith("q")}
    joints = {"time": columns["time"] + 1e3, "q1": columns["q1"], "q2": columns["q2"]}
    files = write(tmp_path / "poses.csv", poses), write(tmp_path / "joints.csv", joints)
    with pytest.raises(McPilcoError, match="stamped by one clock"):
        read_markers(*files)
    with pytest.raises(McPilcoError, match="got both in one"):
        read_markers(write(tmp_path / "both.csv", columns), files[1])
