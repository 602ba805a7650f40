"""Laws of what a recording of an arm holds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mcpilco.identification.collision import arm_recording, read_arm, samples_of
from mcpilco.identification.collision.samples import ArmSamples, RunningSlope, slopes
from mcpilco.recordings import write_recording
from mcpilco.typing import InputError, RecordingError
from tests.mcpilco.identification.collision.free_arm import arm, log


def test_what_is_written_is_what_is_read(tmp_path):
    recording = arm_recording("log", log(3, 3))
    path = write_recording(tmp_path / "log.csv", recording)
    again = read_arm(path, arm().joints)
    seen = np.isfinite(again.states)  # all but what looks like a spike of a position
    assert seen.mean() > 0.999
    np.testing.assert_allclose(again.states[seen], recording.states[seen])
    np.testing.assert_allclose(again.inputs, recording.inputs)
    first, second = samples_of(recording), samples_of(again)
    rows = np.isin(np.round(first.time / 0.008), np.round(second.time / 0.008))
    np.testing.assert_allclose(first[rows].augmented, second.augmented, atol=1e-9)


def test_samples_hold_what_the_log_holds():
    told = log(3, 3)
    found = samples_of(arm_recording("log", told), window=3)
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
    found = samples_of(arm_recording("log", blind), window=3)
    np.testing.assert_allclose(found.dq, slopes(told.position, 0.008, 3)[4:])


def test_masked_samples_are_left_out_and_derivatives_with_them():
    told = log(3, 3)
    position, velocity = told.position.copy(), told.velocity.copy()
    position[100, 2] = velocity[200, 1] = np.nan
    holed = dataclasses.replace(told, position=position, velocity=velocity)
    whole = samples_of(arm_recording("log", told))
    found = samples_of(arm_recording("log", holed))
    assert sorted(set(whole.time) - set(found.time)) == pytest.approx(
        [0.8, 1.6, 1.608, 1.616], abs=1e-9
    )


def test_a_constant_step_thins_samples():
    found = samples_of(arm_recording("log", log(3, 3)))
    thin = found.every(50)
    assert len(thin) == 50
    assert (thin.time[0], thin.time[-1]) == (found.time[0], found.time[-1])
    assert len(found.every(10**6)) == len(found)
    assert len(ArmSamples.joined([thin, thin])) == 100


def test_files_that_do_not_fit_are_refused(tmp_path):
    recording = arm_recording("log", log(3, 3))
    path = write_recording(tmp_path / "log.csv", recording)
    with pytest.raises(RecordingError, match="expected a column for each of hip_position"):
        read_arm(path, ("hip", *arm().joints[1:]))
    dead = recording.states.copy()
    dead[:, 2] = np.nan
    with pytest.raises(InputError, match="samples at which positions, currents and targets"):
        samples_of(dataclasses.replace(recording, states=dead))
    text = path.read_text().replace("base_current", "unused")
    other = tmp_path / "other.csv"
    other.write_text(text)
    with pytest.raises(RecordingError, match="base_current"):
        read_arm(other, arm().joints)
