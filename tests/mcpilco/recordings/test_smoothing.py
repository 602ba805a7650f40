"""Laws of the noise that is found in a recording, and of its smoothed states."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.recordings import noise_std, smoothed
from mcpilco.recordings.smoothing import first_state
from tests.mcpilco.recordings.swings import NOISE, recording, swings


def ratios(states: np.ndarray, forces: np.ndarray, scale: float = 1.0, step: float = 0.0):
    """Noise found over noise added, for each of the systems."""
    rng = np.random.default_rng(1)
    found = []
    for k in range(states.shape[1]):
        noisy = states[:, k] + scale * NOISE * rng.standard_normal(states[:, k].shape)
        if step:
            noisy = step * NOISE * np.round(noisy / (step * NOISE))
        measured = recording(noisy, forces[:, k], resolution=tuple(step * NOISE))
        found.append(noise_std(measured) / NOISE)
    return np.array(found)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("scale", [1.0, 3.0, 10.0])
@pytest.mark.parametrize("hold", [1, 5, 25])
def test_noise_of_a_position_is_found_within_five_percent(hold: int, scale: float) -> None:
    """In the median of recordings of 10 s; one of them has a standard error of 5 % itself."""
    found = ratios(*swings(hold), scale)[:, [0, 2]] / scale
    np.testing.assert_allclose(np.median(found, axis=0), 1.0, atol=0.05)
    np.testing.assert_allclose(found, 1.0, atol=0.2)


def test_motion_is_taken_for_noise_only_where_noise_is_small() -> None:
    """At 0.2 mm and 0.4 mrad, beside accelerations of 10 m/s^2 and 100 rad/s^2."""
    found = ratios(*swings(), 0.2)[:, [0, 2]] / 0.2
    assert (np.median(found, axis=0) > 0.95).all()
    assert (np.median(found, axis=0) < 1.5).all()


def test_noise_of_a_velocity_is_found_in_calm_motion() -> None:
    found = ratios(*swings(hold=25, amplitude=2.0))[:, [1, 3]]
    np.testing.assert_allclose(np.median(found, axis=0), 1.0, atol=0.1)


def test_rounding_adds_its_own_noise() -> None:
    """A step as wide as two standard deviations adds step^2 / 12 to the variance."""
    found = ratios(*swings(), step=2.0)[:, [0, 2]]
    np.testing.assert_allclose(np.median(found, axis=0), np.sqrt(1 + 4 / 12), rtol=0.06)


def test_noise_is_at_least_that_of_the_rounding() -> None:
    rest = recording(np.zeros((200, 4)), np.zeros(200), resolution=(0.01, 0.0, 0.02, 0.0))
    np.testing.assert_allclose(noise_std(rest), np.array([0.01, 0, 0.02, 0]) / np.sqrt(12))


def test_a_few_disturbed_windows_do_not_matter() -> None:
    states, forces = swings()
    rng = np.random.default_rng(2)
    noisy = states[:, 0] + NOISE * rng.standard_normal(states[:, 0].shape)
    kicked = noisy.copy()
    kicked[100:, 0] += 0.5  # a position that jumps
    kicked[250:, 0] += 0.3 * np.arange(250) * 0.02  # a velocity that jumps, as in an impact
    calm, disturbed = (noise_std(recording(y, forces[:, 0]))[0] for y in (noisy, kicked))
    assert disturbed == pytest.approx(calm, rel=0.15)


def test_noise_is_found_between_gaps_and_masked_values() -> None:
    states, forces = swings()
    rng = np.random.default_rng(3)
    noisy = states[:, 0] + NOISE * rng.standard_normal(states[:, 0].shape)
    noisy[50:61] = np.nan
    noisy[::40, 0] = np.nan
    noisy[200:] += 1.0  # what was missed in the second gap
    gaps = ((0.98, 1.22), (3.98, 4.0))
    found = noise_std(recording(noisy, forces[:, 0], gaps=gaps))
    np.testing.assert_allclose(found[[0, 2]] / NOISE[[0, 2]], 1.0, atol=0.15)


def test_what_was_not_measured_has_no_noise() -> None:
    states, forces = swings()
    blind = states[:, 0].copy()
    blind[:, 1] = np.nan
    short = recording(states[:8, 0], forces[:8, 0])
    assert np.isnan(noise_std(recording(blind, forces[:, 0]))[1])
    assert np.isnan(noise_std(short)).all()


def test_of_correlated_noise_only_the_quick_part_is_seen() -> None:
    states, forces = swings()
    rng = np.random.default_rng(4)
    noise = rng.standard_normal((12, 500, 4))
    for k in range(1, 500):
        noise[:, k] = 0.6 * noise[:, k - 1] + 0.8 * noise[:, k]
    found = [
        noise_std(recording(states[:, k] + NOISE * noise[k], forces[:, k])) / NOISE
        for k in range(12)
    ]
    seen = np.median(found, axis=0)[[0, 2]]
    assert (seen > 0.5).all()
    assert (seen < 0.65).all()


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


@pytest.mark.parametrize("dt", [0.02, 0.05, 0.1])
def test_the_state_at_the_first_of_samples_far_apart_is_near_what_was_measured(dt: float) -> None:
    std, t = np.array([2e-3, 2e-2]), dt * np.arange(12)
    exact = np.stack([np.sin(9.0 * t), 9.0 * np.cos(9.0 * t)])
    y = exact + std[:, None] * np.random.default_rng(0).normal(size=exact.shape)
    np.testing.assert_array_less(np.abs(first_state(y, dt, std) - exact[:, 0]), 4.0 * std)
    y[1] = np.nan  # a position alone tells a velocity roughly, the more so the farther they are
    velocity = first_state(y, dt, std)[1]
    assert velocity == pytest.approx(exact[1, 0], rel=0.05 + 2.0 * dt)
