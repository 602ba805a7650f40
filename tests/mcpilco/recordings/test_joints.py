"""Laws of the data of inverse dynamics, and of the recordings they come from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcpilco.recordings import (
    JointData,
    check_joint_data,
    held_out,
    joint_data,
    joints_in,
    kinds_of,
    read_joint_recordings,
)
from mcpilco.typing import InputError, RecordingError
from tests.mcpilco.identification.inverse_dynamics.robots import measured, random_robot


@pytest.fixture
def data() -> JointData:
    rng = np.random.default_rng(0)
    return measured(random_robot(("hinge", "slide"), rng), rng, 100)


def test_good_data_pass(data):
    check_joint_data(data)


def changed(array: np.ndarray, row: int, joint: int, value: float) -> np.ndarray:
    other = array.copy()
    other[row, joint] = value
    return other


def test_a_value_that_is_not_finite_is_told_by_row_and_joint(data):
    with pytest.raises(InputError, match=r"ddq of joint 'joint1' must be finite.*row 7"):
        check_joint_data(replace(data, ddq=changed(data.ddq, 7, 1, np.nan)))


def test_a_joint_that_stands_still_is_refused(data):
    still = np.column_stack([np.full(100, 0.3), data.q[:, 1]])
    with pytest.raises(InputError, match=r"position of joint 'joint0' is constant \(0.3\)"):
        check_joint_data(replace(data, q=still))
    silent = np.column_stack([data.tau[:, 0], np.zeros(100)])
    with pytest.raises(InputError, match="torque of joint 'joint1' is constant"):
        check_joint_data(replace(data, tau=silent))


def test_too_few_samples_are_refused(data):
    with pytest.raises(InputError, match="2 joints need at least 50 samples, got 20"):
        check_joint_data(data[:20])


def test_repeated_rows_are_refused(data):
    with pytest.raises(InputError, match="100 of 200 samples are equal.*give each file once"):
        check_joint_data(JointData.joined([data, data]))


def test_data_of_other_joints_are_not_joined(data):
    with pytest.raises(InputError, match="recordings of one robot"):
        JointData.joined([data, replace(data, joints=("a", "b"))])


def test_thinned_data_keep_both_ends(data):
    thin = data.thinned(10)
    assert len(thin) == 10
    np.testing.assert_array_equal(thin.q[[0, -1]], data.q[[0, -1]])
    assert data.thinned(100) is data


@pytest.mark.usefixtures("unchecked_shapes")
def test_shapes_are_checked(data):
    with pytest.raises(InputError, match=r"tau must have the shape \(100, 2\), got \(99, 2\)"):
        replace(data, tau=data.tau[1:])


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


def test_an_effort_of_ros_is_the_torque_that_the_file_lacks(tmp_path):
    path, columns = log(tmp_path / "log.csv", ("position", "torque"))
    path.write_text(path.read_text().replace("_torque", "_effort"))
    (recording,) = read_joint_recordings([path], JOINTS)
    np.testing.assert_array_equal(recording.inputs, columns["torque"])


def test_letters_name_the_kinds_of_joints():
    assert kinds_of("RrP") == kinds_of("hHS") == ("hinge", "hinge", "slide")
    assert kinds_of(("revolute", "slide", "prismatic")) == ("hinge", "slide", "slide")
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
