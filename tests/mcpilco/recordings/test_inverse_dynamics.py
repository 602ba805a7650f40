from __future__ import annotations

import numpy as np
import pytest

from mcpilco.recordings.inverse_dynamics import (
    held_out,
    joint_data,
    joints_in,
    kinds_of,
    read_joint_recordings,
)
from mcpilco.typing import InputError, RecordingError

JOINTS = ("turn", "push")


def log(path, logged=("position", "velocity", "acceleration", "torque"), rows=300, skip=()):
    """Two joints that swing, as a file; columns are `<joint>_<what>`."""
    t = 0.02 * np.arange(rows)
    w = np.array([2.0, 3.0])
    phase = t[:, None] * w
    columns = {
        "position": np.sin(phase),
        "velocity": w * np.cos(phase),
        "acceleration": -(w**2) * np.sin(phase),
        "torque": np.cos(phase + 1.0),
    }
    header = ["time", *(f"{joint}_{what}" for what in logged for joint in JOINTS)]
    table = np.column_stack([t, *(columns[what] for what in logged)])
    lines = [",".join(header)]
    for number, row in enumerate(table):
        cells = [
            "" if number in skip and k in (1, 2) else repr(float(v)) for k, v in enumerate(row)
        ]
        lines.append(",".join(cells))
    path.write_text("\n".join(lines))
    return path, columns


@pytest.mark.parametrize(
    "logged",
    [
        ("position", "velocity", "acceleration", "torque"),
        ("position", "velocity", "torque"),
        ("position", "torque"),
    ],
)
def test_what_is_not_logged_is_the_slope_of_what_is(tmp_path, logged):
    path, columns = log(tmp_path / "log.csv", logged)
    (recording,) = read_joint_recordings([path], JOINTS)
    data = joint_data(recording, JOINTS, ("hinge", "slide"))
    inner = slice(10, -10)
    for name, what in (("q", "position"), ("dq", "velocity"), ("ddq", "acceleration")):
        size = np.abs(columns[what]).max()
        found, truth = getattr(data, name)[inner], columns[what][inner]
        np.testing.assert_allclose(found, truth, atol=0.01 * size)
    np.testing.assert_array_equal(data.tau, columns["torque"])


def test_gaps_are_left_out(tmp_path):
    path, _ = log(tmp_path / "log.csv", ("position", "torque"), skip=range(100, 150))
    (recording,) = read_joint_recordings([path], JOINTS)
    data = joint_data(recording, JOINTS, ("hinge", "slide"))
    assert 200 < len(data) < 300
    assert np.isfinite(data.ddq).all()


def test_joints_are_named_by_their_positions(tmp_path):
    path, _ = log(tmp_path / "log.csv")
    assert joints_in(path) == JOINTS
    other = tmp_path / "other.csv"
    other.write_text("time,a,b\n0,1,2\n0.1,2,3\n")
    with pytest.raises(RecordingError, match="expected a column <joint>_position"):
        joints_in(other)


def test_a_recording_without_torques_is_refused(tmp_path):
    path, _ = log(tmp_path / "log.csv", ("position", "velocity"))
    with pytest.raises(RecordingError, match="expected a column for each of turn_torque"):
        read_joint_recordings([path], JOINTS)


def test_letters_name_the_kinds_of_joints():
    assert kinds_of("RrP") == ("hinge", "hinge", "slide")
    for wrong in ("", "RX", "R R"):
        with pytest.raises(InputError, match="a letter for each joint"):
            kinds_of(wrong)


def test_the_end_is_held_out(tmp_path):
    path, columns = log(tmp_path / "log.csv")
    (recording,) = read_joint_recordings([path], JOINTS)
    first, last = held_out(joint_data(recording, JOINTS, ("hinge", "slide")), 0.25)
    assert (len(first), len(last)) == (225, 75)
    np.testing.assert_array_equal(last.tau, columns["torque"][-75:])
    with pytest.raises(InputError, match="between 0 and 1, got 1"):
        held_out(first, 1.0)
