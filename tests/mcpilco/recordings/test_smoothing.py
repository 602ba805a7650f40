"""Smoothed states are nearer to the truth than the measured ones, and say by how much."""

from __future__ import annotations

import numpy as np

from mcpilco.recordings import noise_std, smoothed
from tests.mcpilco.recordings.swings import NOISE, recording, swings


def noisy_swing() -> tuple:
    """The truth, the measurement and the force."""
    states, forces = swings(hold=25, amplitude=2.0)
    rng = np.random.default_rng(0)
    return states[:, 0], states[:, 0] + NOISE * rng.standard_normal((500, 4)), forces[:, 0]


def test_smoothing_removes_noise_of_positions() -> None:
    truth, noisy, forces = noisy_swing()
    states, _ = smoothed(recording(noisy, forces))
    error = np.sqrt(np.mean((states - truth) ** 2, axis=0))
    assert (error[[0, 2]] < 0.8 * NOISE[[0, 2]]).all()


def test_a_velocity_that_is_absent_is_the_slope_of_its_position() -> None:
    truth, noisy, forces = noisy_swing()
    noisy[:, [1, 3]] = np.nan
    states, std = smoothed(recording(noisy, forces))
    z = (states - truth) / std
    assert np.isfinite(states).all()
    error = np.sqrt(np.mean((states - truth)[:, [1, 3]] ** 2, axis=0))
    assert (error < [0.05, 0.1]).all()
    assert (np.sqrt(np.mean(z**2, axis=0)) < 1.5).all()
    assert (np.sqrt(np.mean(z**2, axis=0)) > 0.7).all()


def test_a_cubic_is_its_own_smoothing() -> None:
    time = 0.02 * np.arange(60)
    position = 1 + 2 * time - 3 * time**2 + time**3
    velocity = 2 - 6 * time + 3 * time**2
    blank = np.full(60, np.nan)
    states, _ = smoothed(recording(np.column_stack([position, blank, position, blank]), 0 * time))
    np.testing.assert_allclose(states[:, 0], position, atol=1e-10)
    np.testing.assert_allclose(states[:, 1], velocity, atol=1e-8)


def test_no_window_reaches_across_a_gap() -> None:
    time = 0.02 * np.arange(100)
    position = np.where(time < 0.99, time, 5 - time)
    states = np.column_stack([position, np.full(100, np.nan), position, np.full(100, np.nan)])
    smooth, _ = smoothed(recording(states, 0 * time, gaps=((0.98, 1.0),)))
    np.testing.assert_allclose(smooth[:, 1], np.where(time < 0.99, 1.0, -1.0), atol=1e-9)


def test_masked_values_are_filled_in_and_gaps_are_not() -> None:
    truth, noisy, forces = noisy_swing()
    noisy[30, 0] = np.nan
    noisy[101:110] = np.nan
    measured = recording(noisy, forces, gaps=((2.0, 2.2),))
    states, std = smoothed(measured)
    assert abs(states[30, 0] - truth[30, 0]) < 5 * std[30, 0]
    assert std[30, 0] > std[40, 0] * 0.99
    assert np.isnan(states[101:110]).all()
    assert np.isfinite(states[[100, 110]]).all()


def test_the_deviation_is_larger_at_the_ends() -> None:
    _, noisy, forces = noisy_swing()
    measured = recording(noisy, forces)
    _, std = smoothed(measured)
    assert std[0, 0] > 1.3 * np.median(std[:, 0])
    assert np.median(std[:, 0]) < noise_std(measured)[0]
