"""The filter and the smoother of a motion, against truth that they were not given."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import make_smoothing_spline
from scipy.stats import multivariate_normal

import envs  # noqa: F401  registers the cart-pole
from mcpilco.agent import make_env, run_episode
from mcpilco.sensing.motion import Motion, fit_motion, smooth
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


# --- the smoother ---------------------------------------------------------------------------------


def motion_of(task: TaskSpec) -> Motion:
    return Motion.of(dataclasses.replace(task, measured=(0, 2)), CHANGES, NOISE)


def test_smoothing_is_the_regression_on_the_whole_recording(task: TaskSpec) -> None:
    motion = motion_of(task)
    _, measured = simulate(motion, 8, seed=0)
    known, _ = conditioned(motion, measured, 8)
    np.testing.assert_allclose(smooth(motion, measured), known, atol=1e-9)


def test_smoothed_positions_are_a_cubic_smoothing_spline(task: TaskSpec) -> None:
    """Of the same roughness: lambda = noise^2 dt / change^2, without knowledge of the start."""
    motion = dataclasses.replace(motion_of(task), start_std=np.full(4, 1e4))
    measured = np.random.default_rng(3).normal(size=(20, 2))
    states, times = smooth(motion, measured), task.dt * np.arange(20)
    for joint in range(2):
        roughness = NOISE[joint] ** 2 * task.dt / CHANGES[joint] ** 2
        spline = make_smoothing_spline(times, measured[:, joint], lam=roughness)
        np.testing.assert_allclose(states[:, 2 * joint], spline(times), atol=1e-6)
        np.testing.assert_allclose(states[:, 2 * joint + 1], spline(times, 1), atol=1e-5)


def test_smoother_beats_the_filter_on_the_true_velocities_of_a_cart_pole() -> None:
    env = make_env("mcpilco/CartPoleSwingUpPositions-v0")
    rng = np.random.default_rng(0)
    errors = []
    for seed in range(4):
        record = run_episode(env, lambda _: rng.uniform(-10, 10, 1), 30, 0.1, seed=seed, width=4)
        task = env.unwrapped.task
        motion = fit_motion(task, record.observations, np.array(task.measurement_std))
        filtered = motion.filter(record.observations).means
        smoothed = smooth(motion, record.observations)
        differences = np.vstack([[0, 0], np.diff(record.observations, axis=0) / 0.1])
        truth = record.states[:, [1, 3]]
        found = (smoothed[:, [1, 3]], filtered[:, [1, 3]], differences)
        errors.append([np.sqrt(np.mean((v - truth) ** 2, 0)) for v in found])
    smoothed, filtered, differences = np.median(errors, 0)
    assert (smoothed < 0.8 * filtered).all()
    assert (filtered < differences).all()
