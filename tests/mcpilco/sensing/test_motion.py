"""What a Kalman filter knows of a motion, against truth that it was not given."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from mcpilco.sensing.motion import Motion, fit_motion
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

NOISE, CHANGES = np.array([0.01, 0.02]), np.array([0.3, 0.8])


@pytest.fixture
def positions(task: TaskSpec) -> TaskSpec:
    return dataclasses.replace(task, measured=(0, 2))


def simulate(motion: Motion, steps: int, seed: int):
    """States and measurements of a motion."""
    rng = np.random.default_rng(seed)
    mean, covariance = joint(motion, steps)
    states = rng.multivariate_normal(mean, covariance, method="cholesky").reshape(steps, -1)
    noise = motion.noise_std * rng.standard_normal((steps, len(motion.C)))
    return states, states @ motion.C.T + noise


def joint(motion: Motion, steps: int):
    """Mean and covariance of all states in one vector, from the definition."""
    width = len(motion.A)
    W = sum(std**2 * shape for std, shape in zip(motion.change_std, motion.shape, strict=True))
    powers = [np.linalg.matrix_power(motion.A, k) for k in range(steps)]
    effects = np.zeros((steps, width, steps, width))  # of the start, and of each step's noise
    for t in range(steps):
        for k in range(t + 1):
            effects[t, :, k] = powers[t - k]
    effects = effects.reshape(steps * width, steps * width)
    own = np.kron(np.eye(steps), W)
    own[:width, :width] = np.diag(motion.start_std**2)
    mean = np.concatenate([power @ motion.start_mean for power in powers])
    return mean, effects @ own @ effects.T


def conditioned(motion: Motion, measured, seen: int):
    """Mean of all states given the first measurements, by one big regression; log density."""
    steps = len(measured)
    mean, covariance = joint(motion, steps)
    C = np.kron(np.eye(steps), motion.C)[: seen * len(motion.C)]
    noise = np.diag(np.tile(motion.noise_std**2, seen))
    y, spread = measured[:seen].reshape(-1), C @ covariance @ C.T + noise
    known = mean + covariance @ C.T @ np.linalg.solve(spread, y - C @ mean)
    density = multivariate_normal(C @ mean, spread).logpdf(y)
    return known.reshape(steps, -1), density


def test_filter_is_the_regression_on_all_measurements_so_far(positions: TaskSpec) -> None:
    motion = Motion.of(positions, CHANGES, NOISE)
    _, measured = simulate(motion, 8, seed=0)
    filtered = motion.filter(measured)
    for t in range(8):
        known, _ = conditioned(motion, measured, t + 1)
        np.testing.assert_allclose(filtered.means[t], known[t], atol=1e-9)
    _, density = conditioned(motion, measured, 8)
    assert filtered.log_likelihood == pytest.approx(density, abs=1e-8)


def test_white_acceleration_is_the_limit_of_many_random_steps(positions: TaskSpec) -> None:
    motion, parts = Motion.of(positions, CHANGES, NOISE), 1000
    h = positions.dt / parts
    a, b = np.array([[1.0, h], [0.0, 1.0]]), np.array([[h * h / 2], [h]])
    covariance = np.zeros((2, 2))
    for _ in range(parts):
        covariance = a @ covariance @ a.T + b @ b.T * (CHANGES[0] ** 2 / (positions.dt * h))
    W = np.tensordot(CHANGES**2, motion.shape, 1)
    np.testing.assert_allclose(covariance, W[:2, :2], rtol=1e-2)
    assert not W[:2, 2:].any()


def test_gains_are_those_of_the_filter_and_settle(positions: TaskSpec) -> None:
    motion = Motion.of(positions, CHANGES, NOISE)
    gains = motion.gains()
    _, measured = simulate(motion, 6, seed=1)
    known = motion.filter(measured)
    for t in range(6):
        corrected = known.expected[t] + gains[t] @ (measured[t] - motion.C @ known.expected[t])
        np.testing.assert_allclose(corrected, known.means[t], atol=1e-12)
    assert 10 < len(gains) < 1000
    np.testing.assert_allclose(gains[-1], gains[-2], atol=1e-9)


@pytest.mark.parametrize("noise", [NOISE, None])
def test_fit_recovers_the_motion_that_made_the_recording(positions: TaskSpec, noise) -> None:
    truth = Motion.of(positions, CHANGES, np.array([0.02, 0.05]) if noise is None else NOISE)
    _, measured = simulate(truth, 150, seed=2)
    found = fit_motion(positions, measured, noise)
    np.testing.assert_allclose(found.change_std, truth.change_std, rtol=0.2)
    np.testing.assert_allclose(found.noise_std, truth.noise_std, rtol=0.2)


def test_fit_needs_three_measurements(positions: TaskSpec) -> None:
    with pytest.raises(InputError, match="at least 3 measurements, got 2"):
        fit_motion(positions, np.zeros((2, 2)))


def test_fit_takes_a_recording_in_which_nothing_moves(positions: TaskSpec) -> None:
    motion = fit_motion(positions, np.zeros((30, 2)))
    assert np.isfinite(motion.gains()).all()
