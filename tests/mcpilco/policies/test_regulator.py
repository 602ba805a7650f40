"""Laws of the regulator: its gain, its region, when it is trusted, and that it holds a pole."""

from __future__ import annotations

import dataclasses
import math

import gymnasium as gym
import numpy as np
import pytest
import torch

import envs
from mcpilco import MCPILCO
from mcpilco.agent.model import Model
from mcpilco.config import Config, ModelConfig, PolicyConfig
from mcpilco.data import Transitions
from mcpilco.logbook import Callback
from mcpilco.policies import Regulator, riccati
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError
from tests.mcpilco.agent.test_policy_file import ALL
from tests.mcpilco.conftest import make_policy
from tests.mcpilco.point import STEPS, TINY, PointEnv

CART_POLE, DT, FORCE = "mcpilco/CartPoleSwingUp-v0", 0.05, 10.0
UPRIGHT = np.array([0.0, 0.0, math.pi, 0.0])
NUDGE = 1e-4


@pytest.fixture(scope="module")
def spec() -> TaskSpec:
    return gym.make(CART_POLE, dt=DT).unwrapped.task


def plant_slopes() -> tuple[np.ndarray, np.ndarray]:
    """A and B of the plant about upright, by its simulation."""
    steps = NUDGE * np.concatenate([np.eye(5), -np.eye(5)])
    plant = envs.PLANTS[CART_POLE]()
    after = plant.simulate(UPRIGHT + steps[:, :4], steps[:, None, 4:], DT)[:, -1]
    slopes = (after[:5] - after[5:]) / (2.0 * NUDGE)
    return slopes[:4].T, slopes[4:].T


def regulator_of(spec: TaskSpec, room: float = 2.0, memory: int = 0, **config) -> Regulator:
    config = PolicyConfig(regulator=room, **config)
    return Regulator(config, spec, [-FORCE], [FORCE], memory)


@pytest.fixture
def upright(spec: TaskSpec) -> Regulator:
    """The regulator of the cart-pole itself."""
    regulator = regulator_of(spec)
    regulator.hold(*plant_slopes(), np.zeros(1))
    return regulator


def recorded(around: np.ndarray, seed: int, samples: int = 120) -> Transitions:
    """Single steps of the plant from states about one, measured with a little noise."""
    random = np.random.default_rng(seed)
    states = around + random.uniform(-1, 1, (samples, 4)) * [0.3, 1.0, 0.5, 2.0]
    inputs = random.uniform(-FORCE, FORCE, (samples, 1))
    after = envs.PLANTS[CART_POLE]().simulate(states, inputs[:, None], DT)[:, -1]
    states, after = (s + 0.003 * random.standard_normal(s.shape) for s in (states, after))
    return Transitions(states, inputs, after)


def modelled(spec: TaskSpec, rows: Transitions, **config):
    model = Model(ModelConfig(**config), spec)
    model.fit(rows)
    return model.dynamics(rows)


def share_of(regulator: Regulator, states: torch.Tensor) -> torch.Tensor:
    """How much of the command is taken away: a command of 0 and one of 1, compared."""
    none = states.new_zeros(len(states), 1)
    return 1.0 - (regulator(states, none + 1.0) - regulator(states, none))[:, 0]


# --- the gain -------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_the_gain_is_that_of_the_riccati_iteration(seed: int) -> None:
    random = np.random.default_rng(seed)
    A, B = random.normal(size=(4, 4)), random.normal(size=(4, 2))
    Q, R = np.eye(4), np.diag([0.5, 2.0])
    S = Q
    for _ in range(500):
        K = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A)
        S = Q + A.T @ S @ (A - B @ K)
    found = riccati(A, B, Q, R)
    np.testing.assert_allclose(found[0], K, rtol=1e-6)
    np.testing.assert_allclose(found[1], S, rtol=1e-6)
    assert np.abs(np.linalg.eigvals(A - B @ found[0])).max() < 1.0


def test_what_the_inputs_do_not_move_is_named() -> None:
    A, B = np.diag([1.1, 0.5]), np.array([[0.0], [1.0]])
    with pytest.raises(InputError, match="do not move the mode of wind, whose eigenvalue is 1.1"):
        riccati(A, B, np.eye(2), np.eye(1), ("wind", "rudder"))


def test_what_one_input_cannot_move_apart_is_named() -> None:
    """Two equal masses that are pushed alike: the equation has an answer, which holds nothing."""
    A = np.eye(4) + np.diag([0.1, 0.0, 0.1], 1)
    with pytest.raises(
        InputError, match=r"do not move the mode of state \d, whose eigenvalue is 1"
    ):
        riccati(A, np.array([[0.0], [0.2], [0.0], [-0.1]]), np.eye(4), np.eye(1))


def test_a_goal_that_no_input_holds_is_refused(spec: TaskSpec) -> None:
    with pytest.raises(InputError, match=r"no equilibrium within the bounds: \[12.0\]"):
        regulator_of(spec).hold(*plant_slopes(), np.array([12.0]))


def test_an_error_of_one_unit_costs_as_much_as_the_largest_input(spec: TaskSpec) -> None:
    A, B = plant_slopes()
    units = (0.5, 2.0, 0.3, 3.0)
    regulator = regulator_of(spec, regulator_units=units)
    regulator.hold(A, B, np.zeros(1))
    # e = D z: the states in these units have the slopes D^-1 A D and D^-1 B, and unit costs
    D = np.array(units)
    gain, _ = riccati(A / D[:, None] * D, B / D[:, None], np.eye(4), np.array([[FORCE**-2.0]]))
    np.testing.assert_allclose(regulator.gain.numpy() * D, gain, rtol=1e-6)


def test_units_of_another_number_of_states_are_refused(spec: TaskSpec) -> None:
    with pytest.raises(InputError, match="one number for each of the states cart_position"):
        regulator_of(spec, regulator_units=(0.3, 3.0))


def test_units_and_trust_are_checked() -> None:
    with pytest.raises(InputError, match="regulator_units must be positive"):
        PolicyConfig(regulator_units=(1.0, 0.0))
    with pytest.raises(InputError, match="regulator_trust must be at most 1"):
        PolicyConfig(regulator_trust=1.5)


def test_without_a_goal_it_says_how_to_give_one(spec: TaskSpec) -> None:
    with pytest.raises(InputError, match=r"set TaskSpec.goal"):
        regulator_of(dataclasses.replace(spec, goal=None))


# --- the region -----------------------------------------------------------------------------------


def test_at_the_goal_it_is_the_linear_law(upright: Regulator) -> None:
    e = 0.01 * np.random.default_rng(0).standard_normal((50, 4))
    found = upright(torch.from_numpy(UPRIGHT + e), torch.full((50, 1), 7.0, dtype=torch.float64))
    np.testing.assert_allclose(found, -e @ upright.gain.numpy().T, atol=1e-6)


def test_full_turns_look_alike(upright: Regulator) -> None:
    states = torch.from_numpy(UPRIGHT + 0.2 * np.random.default_rng(1).standard_normal((200, 4)))
    turned = states + torch.tensor([0.0, 0.0, 4 * math.pi, 0.0], dtype=torch.float64)
    commands = torch.zeros(200, 1, dtype=torch.float64)
    torch.testing.assert_close(upright(turned, commands), upright(states, commands))
    shares = share_of(upright, states)
    assert 0.0 <= float(shares.min()) < 0.01 < 0.99 < float(shares.max())


def test_outside_its_region_the_policy_acts_to_the_bit(spec: TaskSpec, upright: Regulator) -> None:
    policy = make_policy(spec)
    states = torch.from_numpy(UPRIGHT + 3.0 * np.random.default_rng(2).standard_normal((500, 4)))
    outside = share_of(upright, states) == 0.0
    plain = policy(states)
    policy.regulator = upright
    assert 400 < int(outside.sum()) < 500
    assert torch.equal(policy(states)[outside], plain[outside])
    assert not torch.equal(policy(states)[~outside], plain[~outside])


def test_hanging_is_outside_however_wide_the_region(spec: TaskSpec) -> None:
    regulator = regulator_of(spec, room=1e3)
    regulator.hold(*plant_slopes(), np.zeros(1))
    q = torch.linspace(0.0, math.pi, 181, dtype=torch.float64)
    states = torch.from_numpy(UPRIGHT)[None].repeat(181, 1)
    states[:, 2] = q
    shares = share_of(regulator, states)
    assert bool((shares[:91] <= 1e-12).all())
    assert bool((shares[121:] > 1.0 - 1e-12).all())
    assert float(shares.diff().abs().max()) < 0.04  # it jumps nowhere


def test_its_inputs_keep_their_bounds(upright: Regulator) -> None:
    states = torch.from_numpy(UPRIGHT + 0.5 * np.random.default_rng(3).standard_normal((500, 4)))
    asked = (torch.from_numpy(UPRIGHT) - states) @ upright.gain.T
    found = upright(states, torch.zeros(500, 1, dtype=torch.float64))
    assert float(asked.abs().max()) > 1.5 * FORCE
    assert float(found.abs().max()) <= FORCE


def test_alone_it_holds_a_pole(upright: Regulator) -> None:
    env = gym.make(CART_POLE, dt=DT, max_episode_steps=100)
    for seed, turns in ((0, 0), (1, 1), (2, -2)):
        start = UPRIGHT + np.array([0.1, 0.0, 0.15 + 2 * math.pi * turns, 0.0])
        observed, _ = env.reset(seed=seed, options={"state": start})
        for _ in range(100):
            states = torch.from_numpy(observed)[None]
            command = upright(states, torch.zeros(1, 1, dtype=torch.float64))
            observed, *_, info = env.step(command[0].numpy())
        assert info["is_success"]


# --- learned --------------------------------------------------------------------------------------


@pytest.mark.parametrize("memory", [0, 2])
def test_of_a_gp_near_the_goal_the_gain_is_that_of_the_plant(
    spec: TaskSpec, upright: Regulator, memory: int
) -> None:
    rows = recorded(UPRIGHT, seed=0)
    if memory:  # of which the plant knows nothing
        past = np.random.default_rng(1).uniform(-FORCE, FORCE, (len(rows), memory))
        after = np.concatenate([rows.inputs, past[:, :-1]], 1)
        states = np.concatenate([rows.states, past], 1)
        rows = Transitions(states, rows.inputs, np.concatenate([rows.next_states, after], 1))
    regulator = regulator_of(spec, memory=memory)
    share = regulator.learn(modelled(spec, rows, kernel="rbf+mpk", memory=memory))
    assert share > 0.95
    assert regulator.acts
    gain = regulator.gain.numpy()
    np.testing.assert_allclose(gain[:, :4], upright.gain, rtol=0.15)
    assert np.abs(gain[:, 4:]).max(initial=0.0) < 0.05
    assert abs(float(regulator.inputs)) < 0.3


def test_far_from_the_goal_a_gp_is_not_trusted(spec: TaskSpec) -> None:
    regulator = regulator_of(spec)
    dynamics = modelled(spec, recorded(np.zeros(4), seed=0), kernel="rbf")
    assert regulator.learn(dynamics) < 0.9
    assert not regulator.acts


def test_it_acts_from_the_share_on_that_is_asked_for(spec: TaskSpec) -> None:
    aside = UPRIGHT - [0.0, 0.0, 1.0, 0.0]
    dynamics = modelled(spec, recorded(aside, seed=0, samples=15), kernel="rbf")
    share = regulator_of(spec).learn(dynamics)
    assert 0.1 < share < 0.9
    for trust, acts in ((share - 0.02, True), (share + 0.02, False)):
        regulator = regulator_of(spec, regulator_trust=trust)
        assert regulator.learn(dynamics) == share
        assert regulator.acts is acts


def test_of_a_plant_it_is_trusted_from_data_of_anywhere(spec: TaskSpec, upright: Regulator) -> None:
    regulator = regulator_of(spec)
    dynamics = modelled(spec, recorded(np.zeros(4), seed=0), kernel="rbf", mean="physics")
    assert regulator.learn(dynamics) > 0.9
    np.testing.assert_allclose(regulator.gain, upright.gain, rtol=0.15)


def test_one_that_had_a_law_loses_it_where_the_model_forgets(
    spec: TaskSpec, upright: Regulator
) -> None:
    upright.learn(modelled(spec, recorded(np.zeros(4), seed=0), kernel="rbf"))
    assert not upright.acts


def test_of_a_model_without_finite_slopes_there_is_none(spec: TaskSpec, upright: Regulator) -> None:
    dynamics = modelled(spec, recorded(UPRIGHT, seed=0), kernel="rbf")
    dynamics.posterior.alpha[0, 0] = math.nan
    assert upright.learn(dynamics) == 0.0
    assert not upright.acts


# --- an agent's -----------------------------------------------------------------------------------


class AimedEnv(PointEnv):
    """A point mass that shall rest at 1 m."""

    task = dataclasses.replace(PointEnv.task, goal=(1.0, 0.0))


REGULATED = dataclasses.replace(TINY, policy=PolicyConfig(bases=6, regulator=2.0), exploration=18)


def test_by_default_there_is_none(spec: TaskSpec) -> None:
    policy = MCPILCO.make_policy(Config(), spec, [-FORCE], [FORCE])
    assert policy.regulator is None
    assert policy.behind == []


def test_a_point_mass_is_brought_to_rest_by_what_was_learned() -> None:
    env = AimedEnv()
    agent = MCPILCO("SumOfGaussians", env, config=REGULATED).learn(4 * STEPS)
    assert agent.policy.regulator.acts
    controller = agent.controller()
    env.reset(seed=0)
    env.state = np.array([0.8, 0.0])
    for _ in range(25):
        env.step(controller(env.state))
    np.testing.assert_allclose(env.state, [1.0, 0.0], atol=0.02)


def test_saved_and_loaded_it_is_the_same(tmp_path) -> None:
    agent = MCPILCO("SumOfGaussians", AimedEnv(), config=REGULATED).learn(4 * STEPS)
    again = MCPILCO.load(agent.save(tmp_path / "agent.npz"), AimedEnv())
    states = torch.from_numpy(np.random.default_rng(0).normal([1.0, 0.0], 0.5, (50, 2)))
    assert again.policy.regulator.acts
    assert torch.equal(again.policy(states), agent.policy(states))
    assert agent.task.goal == again.task.goal == (1.0, 0.0)


def test_a_task_without_a_goal_is_refused_at_once() -> None:
    with pytest.raises(InputError, match="without a goal"):
        MCPILCO("SumOfGaussians", PointEnv(), config=REGULATED)


def test_the_metrics_tell_how_far_it_is_trusted() -> None:
    told = {}

    class Listener(Callback):
        def on_model_fitted(self, values):
            told.update(values)

    MCPILCO("SumOfGaussians", AimedEnv(), config=REGULATED).learn(4 * STEPS, callback=Listener())
    assert 0.9 <= told["model/regulator"] <= 1.0


def test_tasks_of_this_package_have_goals() -> None:
    assert gym.make(ALL).unwrapped.task.goal == (0.0, 0.0, math.pi, 0.0)
    assert gym.make("mcpilco/Pendubot-v0").unwrapped.task.goal == (math.pi, 0.0, 0.0, 0.0)
    assert gym.make("mcpilco/Pendulum-v0").unwrapped.task.goal == (math.pi, 0.0)
