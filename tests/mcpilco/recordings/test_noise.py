"""The noise that was added is found, whatever the motion."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.recordings import noise_std
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
