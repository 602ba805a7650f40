"""Laws of what a recording of an arm holds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mcpilco.files import write_arrays
from mcpilco.recordings import ArmSamples, RunningSlope, arm_samples, columns_of, read_arm
from mcpilco.recordings.arms import slopes
from mcpilco.typing import InputError, RecordingError
from tests.mcpilco.identification.collision.free_arm import arm, log

JOINTS = arm().joints


def arrays_of(told) -> dict[str, np.ndarray]:
    """The columns of a log, as a file has them."""
    found = {"time": told.time + 7.0}
    for j, joint in enumerate(JOINTS):
        for column in ("position", "velocity", "current"):
            found[f"{joint}_{column}"] = getattr(told, column)[:, j]
            found[f"{joint}_target_{column}"] = getattr(told, f"target_{column}")[:, j]
    return found


@pytest.fixture
def path(tmp_path):
    return write_arrays(tmp_path / "log.npz", arrays_of(log(3, 3)))


def test_what_is_written_is_what_is_read(path):
    told, found = log(3, 3), read_arm(path, JOINTS)
    assert set(columns_of(JOINTS)) | {"time"} == set(arrays_of(told))
    for name in ("position", "velocity", "current", "target_position", "target_current"):
        np.testing.assert_array_equal(getattr(found, name), getattr(told, name))
    np.testing.assert_allclose(found.time, told.time, atol=1e-9)
    assert (found.name, found.remarks, found.force) == ("log", (), None)
    np.testing.assert_allclose(arm_samples(found).augmented, arm_samples(told).augmented, atol=1e-8)


def test_columns_have_the_names_that_the_file_gives_them(tmp_path):
    arrays = arrays_of(log(3, 3))
    arrays["q1"] = arrays.pop("base_position")
    path = write_arrays(tmp_path / "log.npz", arrays)
    with pytest.raises(RecordingError, match="expected a column for each of base_position"):
        read_arm(path, JOINTS)
    found = read_arm(path, JOINTS, {"base_position": "q1"})
    np.testing.assert_array_equal(found.position[:, 0], log(3, 3).position[:, 0])
    with pytest.raises(InputError, match="got hip_position"):
        read_arm(path, JOINTS, {"hip_position": "q1"})


def test_velocities_may_be_absent_but_not_those_of_targets(tmp_path):
    arrays = arrays_of(log(3, 3))
    del arrays["elbow_velocity"]
    found = read_arm(write_arrays(tmp_path / "a.npz", arrays), JOINTS)
    assert np.isnan(found.velocity[:, 2]).all()
    assert len(arm_samples(found)) == len(found.time) - 4
    del arrays["elbow_target_velocity"]
    with pytest.raises(RecordingError, match="elbow_target_velocity"):
        read_arm(write_arrays(tmp_path / "b.npz", arrays), JOINTS)


def test_a_faster_log_is_thinned_and_any_other_refused(path):
    found = read_arm(path, JOINTS, dt=0.024)
    np.testing.assert_array_equal(found.position, log(3, 3).position[::3])
    for dt in (0.02, 0.004):
        with pytest.raises(RecordingError, match=f"expected samples every {dt:g} s"):
            read_arm(path, JOINTS, dt=dt)


def test_rows_out_of_order_are_left_out_with_a_remark(tmp_path):
    arrays = arrays_of(log(3, 3))
    arrays["time"] = arrays["time"].copy()
    arrays["time"][[50, 60]] = arrays["time"][49], np.nan
    found = read_arm(write_arrays(tmp_path / "log.npz", arrays), JOINTS)
    assert "1 row without a time stamp left out, the first of them row 61." in found.remarks
    assert any("1 row left out, whose time stamps repeat" in remark for remark in found.remarks)
    assert len(found.time) == len(log(3, 3).time) - 2


def test_samples_hold_what_the_log_holds():
    told = log(3, 3)
    found = arm_samples(told, window=3)
    assert len(found) == len(told.time) - 2
    np.testing.assert_array_equal(found.q, told.position[2:])
    np.testing.assert_array_equal(found.i, told.current[2:])
    np.testing.assert_array_equal(found.eq, (told.target_position - told.position)[2:])
    np.testing.assert_array_equal(found.augmented[:, 30:], told.target_current[2:])
    assert found.augmented.shape[1] == 36


def test_slopes_are_exact_for_straight_lines_and_see_the_past_only():
    t = 0.1 * np.arange(20)[:, None]
    x = 3.0 * t + 1.0
    found = slopes(x, 0.1, 5)
    assert np.isnan(found[:4]).all()
    np.testing.assert_allclose(found[4:], 3.0)
    x[10:] += 7.0
    np.testing.assert_allclose(slopes(x, 0.1, 5)[4:10], 3.0)


def test_a_running_slope_is_the_slope():
    x = np.random.default_rng(0).normal(size=(30, 4))
    running = RunningSlope(0.01, 4)
    np.testing.assert_allclose([running(row) for row in x], slopes(x, 0.01, 4))
    running.reset()
    assert np.isnan(running(x[0])).all()


def test_velocities_that_were_not_measured_are_derivatives():
    told = log(3, 3)
    blind = dataclasses.replace(told, velocity=np.full_like(told.velocity, np.nan))
    found = arm_samples(blind, window=3)
    np.testing.assert_allclose(found.dq, slopes(told.position, 0.008, 3)[4:])


def test_unknown_samples_are_left_out_and_derivatives_with_them():
    told = log(3, 3)
    current, velocity = told.current.copy(), told.velocity.copy()
    current[100, 2] = velocity[200, 1] = np.nan
    found = arm_samples(dataclasses.replace(told, current=current, velocity=velocity))
    lost = set(arm_samples(told).time) - set(found.time)
    assert sorted(lost) == pytest.approx([0.8, 1.6, 1.608, 1.616], abs=1e-9)


def test_no_derivative_is_taken_across_a_gap():
    told = log(3, 3)
    rows = np.r_[0:300, 340 : len(told.time)]
    arrays = {k: v[rows] for k, v in vars(told).items() if isinstance(v, np.ndarray)}
    found = arm_samples(dataclasses.replace(told, **arrays))
    at = np.searchsorted(found.time, told.time[340])
    assert found.time[at] == told.time[342]
    assert found.time[at - 1] == told.time[299]


def test_a_constant_step_thins_samples():
    found = arm_samples(log(3, 3))
    thin = found.thinned(50)
    assert len(thin) == 50
    assert (thin.time[0], thin.time[-1]) == (found.time[0], found.time[-1])
    assert len(found.thinned(10**6)) == len(found)
    assert len(ArmSamples.joined([thin, thin])) == 100


def test_recordings_without_currents_or_full_of_holes_are_refused(tmp_path):
    arrays = arrays_of(log(3, 3))
    arrays["elbow_current"] = np.full_like(arrays["time"], np.nan)
    with pytest.raises(RecordingError, match="the measured current of elbow, got empty cells"):
        read_arm(write_arrays(tmp_path / "log.npz", arrays), JOINTS)
    told = log(3, 3)
    current = np.where(np.arange(len(told.time))[:, None] % 2, np.nan, told.current)
    with pytest.raises(InputError, match="the others hold NaN or empty cells"):
        arm_samples(dataclasses.replace(told, current=current))
    short = {name: column[:5] for name, column in arrays.items()}
    with pytest.raises(RecordingError, match="at least 10 rows"):
        read_arm(write_arrays(tmp_path / "short.npz", short), JOINTS)
