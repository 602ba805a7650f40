"""Smoothed states, against truth that the smoother was not given."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.interpolate import make_smoothing_spline

import envs  # noqa: F401  registers the cart-pole
from mcpilco.agent import make_env, run_episode
from mcpilco.sensing.motion import Motion, fit_motion
from mcpilco.sensing.smoother import smooth
from mcpilco.task import TaskSpec
from tests.mcpilco.sensing.test_motion import CHANGES, NOISE, conditioned, simulate


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
