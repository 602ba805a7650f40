"""A made-up cart-pole: its picture, a rollout and the particles predicted for it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from mcpilco.data import Prediction, Rollout, TrialResult
from mcpilco.show.scene import Pose, Scene, Shape
from mcpilco.task import TaskSpec

DT = 0.1
STEPS = 30
PARTICLES = 80
_HALF_LENGTH = 0.25


def _tip(states: np.ndarray) -> np.ndarray:
    x, angle = states[..., 0], states[..., 2]
    return np.stack(
        [x + 2 * _HALF_LENGTH * np.sin(angle), 0 * x, -2 * _HALF_LENGTH * np.cos(angle)], axis=-1
    )


def _poses(states: np.ndarray) -> dict[str, Pose]:
    x, angle = states[:, 0], states[:, 2]
    zero, one = 0 * x, 0 * x + 1
    cart = Pose(np.stack([x, zero, zero], axis=-1), np.stack([zero, zero, zero, one], axis=-1))
    # The pole's own z axis points from the joint to the tip: turned by pi - angle about y.
    half = (np.pi - angle) / 2
    centre = (cart.translation + _tip(states)) / 2
    return {
        "cart": cart,
        "pole": Pose(centre, np.stack([zero, np.sin(half), zero, np.cos(half)], axis=-1)),
    }


@pytest.fixture
def scene() -> Scene:
    return Scene(
        shapes={
            "cart": Shape("box", (0.1, 0.06, 0.05), (80, 120, 200)),
            "pole": Shape("capsule", (0.02, _HALF_LENGTH), (220, 140, 60)),
        },
        poses=_poses,
        marker=_tip,
        fixed=((Shape("box", (3.0, 0.01, 0.01), (90, 90, 90)), (0.0, 0.0, -0.06)),),
        target=(0.0, 0.0, 2 * _HALF_LENGTH),
    )


def _motion(times: np.ndarray, swing: float | np.ndarray) -> np.ndarray:
    """States of a smooth swing-up that pushes the cart `swing` [m] aside."""
    ramp = 1 / (1 + np.exp(-5 * (times - 1.5)))
    x = swing * np.sin(2.5 * times) * np.exp(-times)
    angle = np.pi * ramp + 0.6 * np.sin(6 * times) * np.exp(-times) + 0 * x
    return np.stack([x, np.gradient(x, DT, axis=0), angle, np.gradient(angle, DT, axis=0)], axis=-1)


@pytest.fixture
def rollout(task: TaskSpec) -> Rollout:
    rng = np.random.default_rng(0)
    times = DT * np.arange(STEPS + 1)
    states = _motion(times, 1.2)
    return Rollout(
        dt=DT,
        observations=states + 0.01 * rng.standard_normal(states.shape),
        inputs=8 * np.sin(4 * times[:-1, None]),
        rewards=1 - task.cost(torch.as_tensor(states[1:])).numpy(),
        states=states,
    )


@pytest.fixture
def prediction(task: TaskSpec) -> Prediction:
    rng = np.random.default_rng(1)
    times = DT * np.arange(STEPS + 1)[:, None]
    states = _motion(times, 1.2 + 0.2 * rng.standard_normal(PARTICLES))
    states = states + 0.05 * times[..., None] * rng.standard_normal((1, PARTICLES, 4))
    inputs = 8 * np.sin(4 * times[:-1, :, None]) + rng.standard_normal((1, PARTICLES, 1))
    return Prediction(states, inputs, task.cost(torch.as_tensor(states[1:])).numpy())


@pytest.fixture
def results(rollout: Rollout, prediction: Prediction) -> list[TrialResult]:
    first = TrialResult(
        trial=1, experience_s=3.0, predicted_cost=14.0, predicted_cost_std=2.0, real_cost=20.0,
        success=False, noise_std=(0.01, 0.02), policy_steps=100,
        starts=1, wall_s=1.0, cpu_s=1.0, rollout=rollout, prediction=prediction,
    )  # fmt: skip
    second = dataclasses.replace(
        first, trial=2, experience_s=6.0, predicted_cost=9.0, real_cost=9.5, success=True
    )
    return [first, second]
