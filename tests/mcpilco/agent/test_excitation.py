"""Laws of planned inputs: they excite more than random ones, within the bounds, reproducibly."""

from __future__ import annotations

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
import torch

import envs  # noqa: F401  registers its ids
from mcpilco.agent.agent import MCPILCO
from mcpilco.agent.excitation import PLANNING, PlannedInputs, _Crude
from mcpilco.config import CART_POLE, PRESETS, Config, ModelConfig
from mcpilco.data import Transitions
from mcpilco.dynamics import AngleAugmentation
from mcpilco.policies import QuadraticCost
from mcpilco.task import TaskSpec

LOW, HIGH = np.array([-10.0]), np.array([10.0])
HORIZON = 30


@pytest.fixture(scope="module")
def cart_pole() -> gym.Env:
    return gym.make(CART_POLE)


@pytest.fixture
def task(cart_pole: gym.Env) -> TaskSpec:
    return cart_pole.unwrapped.task  # type: ignore[attr-defined]


def angles_of(env: gym.Env, act, seed: int) -> np.ndarray:
    """The pole's angles under these inputs [rad]."""
    observation, _ = env.reset(seed=seed)
    angles = [observation[2]]
    for _ in range(HORIZON):
        observation, *_ = env.step(act(observation).astype(np.float32))
        angles.append(observation[2])
    return np.array(angles)


@pytest.mark.slow
def test_planned_inputs_lift_a_pole_above_the_horizontal_more_often_than_random_ones(
    cart_pole: gym.Env, task: TaskSpec
):
    above = {"planned": 0, "random": 0}
    for seed in range(10):
        random = np.random.default_rng(seed)
        planned = PlannedInputs(task, LOW, HIGH, HORIZON, random)
        for kind, act in ("planned", planned), ("random", lambda _: random.uniform(LOW, HIGH)):  # noqa: B023
            above[kind] += (np.cos(angles_of(cart_pole, act, seed)) < -0.3).sum() >= 3
    assert above["planned"] >= 8
    assert above["planned"] >= above["random"] + 3


def test_inputs_are_within_the_bounds_equal_for_equal_seeds_and_held_for_a_stretch(task: TaskSpec):
    states = np.random.default_rng(0).normal(size=(100, 4))
    low = np.array([-2.0])

    def inputs() -> np.ndarray:
        act = PlannedInputs(task, low, HIGH, 100, np.random.default_rng(1))
        return np.array([act(state) for state in states])

    found = inputs()
    assert found.shape == (100, 1)
    assert (found >= low).all()
    assert (found <= HIGH).all()
    assert (found == inputs()).all()
    stretches = found.reshape(25, 4)  # of 100 steps, in at most 30 stretches
    assert (stretches == stretches[:, :1]).all()
    assert len(np.unique(stretches[:, 0])) > 10


def linear(rows: int, seed: int) -> Transitions:
    """A linear system's stretches."""
    rng = np.random.default_rng(seed)
    x, u = rng.normal(size=(rows, 2)), rng.uniform(-1, 1, (rows, 1))
    return Transitions(x, u, after(x, u))


def after(x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return x @ np.array([[0.9, 0.2], [-0.3, 0.8]]).T + u @ np.array([[0.1], [0.7]]).T


@torch.no_grad()
def test_the_crude_model_foresees_a_linear_system():
    model = _Crude(AngleAugmentation(2, ()), linear(30, 0), PLANNING)
    plans = torch.from_numpy(np.random.default_rng(1).uniform(-1, 1, (5, 6, 1)))
    states, _ = model.ways(torch.tensor([0.5, -0.5]).double(), plans)
    x = np.repeat([[0.5, -0.5]], 5, 0)
    for step in range(6):
        x = after(x, plans[:, step].numpy())
        assert np.abs(states[:, step].numpy() - x).max() < 0.15


@torch.no_grad()
def test_information_is_none_where_all_was_seen_and_adds_up_where_nothing_was():
    rows = linear(40, 0)
    numbers = dataclasses.replace(PLANNING, noise=1e-4)
    model = _Crude(AngleAugmentation(2, ()), rows, numbers)
    seen = torch.from_numpy(np.concatenate([rows.states, rows.inputs], 1))
    assert model.covariance(seen[None, :5]).abs().max() < 1e-3
    far = 100.0 * torch.arange(1, 6, dtype=torch.float64)[:, None].expand(-1, 3)
    assert torch.allclose(model.covariance(far[None]), torch.eye(5).double(), atol=1e-6)


def test_episodes_before_count_as_known(task: TaskSpec):
    rng = np.random.default_rng(0)
    rows = Transitions(*(rng.normal(size=(30, n)) for n in (4, 1, 4)))
    drawn = np.random.default_rng(1).uniform(LOW, HIGH)
    new = PlannedInputs(task, LOW, HIGH, HORIZON, np.random.default_rng(1))
    assert new(np.zeros(4)) == drawn
    later = PlannedInputs(task, LOW, HIGH, HORIZON, np.random.default_rng(1), [rows])
    assert later(np.zeros(4)) != drawn


def without_a_wide_cost(task: TaskSpec) -> TaskSpec:
    return dataclasses.replace(task, cost=QuadraticCost((0.0,) * 4, (1.0,) * 4, (1.0,)))


def in_part(task: TaskSpec) -> TaskSpec:
    return dataclasses.replace(task, measured=(0, 2))


def fast(task: TaskSpec) -> TaskSpec:
    return dataclasses.replace(task, dt=0.01)


@pytest.mark.parametrize("change", [without_a_wide_cost, in_part, fast])
def test_tasks_for_which_nothing_can_be_planned_say_so(task: TaskSpec, change):
    assert PlannedInputs.applies(task)
    assert not PlannedInputs.applies(change(task))


@pytest.mark.parametrize(
    ("config", "planned"),
    [
        (Config(), True),
        (Config(excitation="random"), False),
        (Config(model=ModelConfig(memory=2)), False),
        (Config(model=ModelConfig(delay=0.1)), False),
        (PRESETS["thesis"].config, False),
    ],
)
def test_an_agent_plans_its_first_inputs_where_it_can(
    cart_pole: gym.Env, config: Config, planned: bool
):
    agent = MCPILCO("SumOfGaussians", cart_pole, config=config, seed=3)
    act = agent._exciting(np.random.default_rng(0), HORIZON, [])
    assert isinstance(act, PlannedInputs) == planned
    if not planned:
        assert act(np.zeros(4)) == np.random.default_rng(0).uniform(LOW, HIGH)
