"""Logs of real machines, where they are at hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mcpilco.recordings import noise_std, read_recording, smoothed

ONE = {
    "time": "time_s",
    "angle": "position_rad",
    "velocity": "velocity_rad_s",
    "torque": "torque_measured_nm",
}
TWO = {
    "time": "time_s",
    "q1": "position1_rad",
    "q2": "position2_rad",
    "dq1": "velocity1_rad_s",
    "dq2": "velocity2_rad_s",
    "tau1": "torque1_measured_nm",
    "tau2": "torque2_measured_nm",
}


def pendulum(data: Path, name: str, **options):
    return read_recording(
        data / "dfki_pendulum" / f"pendulum_{name}.csv",
        ("angle", "velocity"),
        ("torque",),
        angles=(0,),
        velocities=((0, 1),),
        columns=ONE,
        **options,
    )


@pytest.mark.parametrize(
    ("name", "dt", "seconds"), [("dircol", 0.003, 3.5), ("energy", 0.005, 20), ("ddp", 0.002, 6)]
)
def test_a_pendulums_log_is_read_whole(data: Path, name: str, dt: float, seconds: float) -> None:
    recording = pendulum(data, name)
    assert recording.dt == pytest.approx(dt, rel=1e-3)
    assert recording.time[-1] == pytest.approx(seconds, rel=0.01)
    assert recording.gaps == ()
    assert np.isfinite(recording.states).all()
    assert recording.resolution[0] == pytest.approx(0.00291, rel=0.01)


def test_the_late_second_row_of_a_log_is_a_gap(data: Path) -> None:
    assert pendulum(data, "release").gaps == ((0.0, pytest.approx(0.025)),)


def test_the_velocity_of_a_log_is_found_from_its_position(data: Path) -> None:
    recording = pendulum(data, "energy", dt=0.02)
    blind = recording.states.copy()
    blind[:, 1] = np.nan
    states, std = smoothed(replace(recording, states=blind))
    error = np.abs(states - recording.states)[:, 1]
    assert np.median(error) < 0.05 * np.std(recording.states[:, 1])
    assert np.isfinite(std).all()


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", ["double_chirp_both", "double_chirp_both_c"])
def test_a_double_pendulums_log_is_read(data: Path, name: str) -> None:
    recording = read_recording(
        data / "dfki_double_pendulum" / f"{name}.csv",
        ("q1", "dq1", "q2", "dq2"),
        ("tau1", "tau2"),
        angles=(0, 2),
        velocities=((0, 1), (2, 3)),
        columns=TWO,
    )
    assert recording.dt == pytest.approx(0.002, rel=1e-3)
    assert np.isnan(recording.states).mean() < 0.002
    noise = noise_std(recording)
    assert (noise[[0, 2]] < 1e-3).all()
    assert (noise[[0, 2]] >= 0.00038 / np.sqrt(12) * 0.99).all()
