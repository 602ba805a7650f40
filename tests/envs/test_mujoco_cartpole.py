"""Laws of the cart-pole env in MuJoCo: it is the analytic one, but for who integrates."""

from __future__ import annotations

import copy
import json
import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest

import envs
from envs.mujoco_cartpole import (
    MujocoCartPoleSwingUpEnv,
    MujocoSimulator,
    count_steps,
    fitting_step,
)
from envs.mujoco_cartpole_model import BUILT_IN, build_model
from envs.plants import cart_pole
from mcpilco.policies import QuadraticCost
from mcpilco.typing import EnvError, InputError
from tests.reference.cartpole import CartPoleDynamics

ID = "mcpilco/MujocoCartPoleSwingUp-v0"
ANALYTIC = "mcpilco/CartPoleSwingUp-v0"


def episode(env: gym.Env, steps: int = 30) -> list[tuple]:
    """What comes back from a seeded episode with random forces, but for the observations' noise."""
    rng = np.random.default_rng(0)
    observation, info = env.reset(seed=3)
    found = [(observation, 0.0, False, info)]
    for _ in range(steps):
        action = rng.uniform(-12, 12, 1).astype(np.float32)
        observation, reward, _, truncated, info = env.step(action)
        found.append((observation, reward, truncated, info))
    return found


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"cart_mass": 0.8, "pole_mass": 0.2, "pole_length": 0.7, "cart_friction": 0.3},
        {"gravity": 3.7, "force_limit": 20.0, "start_std": 0.3, "noise_std": [0.1, 0.2, 0.0, 0.0]},
        {"dt": 0.05, "max_episode_steps": 60, "cost_lengthscales": (1.0, 3.0)},
        {"dt": 0.033, "cost": QuadraticCost((0.0, 0.0, 3.0, 0.0), (1.0, 0.1, 2.0, 0.0), (0.05,))},
    ],
    ids=["default", "masses", "limits", "sampling", "cost"],
)
def test_seeded_episode_is_that_of_the_analytic_env(options):
    ours, theirs = (gym.make(name, **options) for name in (ID, ANALYTIC))
    assert ours.unwrapped.task == theirs.unwrapped.task
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.spec.max_episode_steps == theirs.spec.max_episode_steps
    for mine, yours in zip(episode(ours), episode(theirs), strict=True):
        np.testing.assert_allclose(mine[0], yours[0], atol=1e-5)
        assert mine[1] == pytest.approx(yours[1], abs=1e-5)
        assert mine[2] == yours[2]
        assert mine[3].keys() == yours[3].keys()
        for key in ("is_success", "time_up_s"):
            assert mine[3][key] == yours[3][key]
        assert mine[3]["mean_abs_cart_m"] == pytest.approx(yours[3]["mean_abs_cart_m"], abs=1e-5)


def test_shorter_step_brings_it_closer_to_the_analytic_env():
    analytic = episode(envs.CartPoleSwingUpEnv())[-1][3]["state"]

    def distance(timestep):
        state = episode(MujocoCartPoleSwingUpEnv(timestep=timestep))[-1][3]["state"]
        return np.abs(state - analytic).max()

    assert distance(0.001) < 0.01 * distance(0.005)


@pytest.mark.parametrize("dt", [0.1, 0.05, 0.025, 0.033])
def test_built_in_step_is_the_longest_up_to_2_ms_that_divides_the_time_of_a_look(dt):
    env = MujocoCartPoleSwingUpEnv(dt=dt)
    steps = env.swing_up.sample_s / env.simulator.timestep
    assert steps == pytest.approx(round(steps), rel=1e-9)
    assert env.simulator.timestep <= 0.002 < env.swing_up.sample_s / (round(steps) - 1)


def test_user_model_is_simulated_with_its_own_numbers(tmp_path):
    path = tmp_path / "heavy.xml"
    text = BUILT_IN.read_text().replace(
        'mass="0.5" diaginertia="0.002', 'mass="0.9" diaginertia="0.002'
    )
    path.write_text(text.replace("-10 10", "-4 4").replace('damping="0.1"', 'damping="0.3"'))
    mine = gym.make(ID, model=str(path))
    same = gym.make(ID, cart_mass=0.9, cart_friction=0.3, force_limit=4.0)
    assert mine.action_space == same.action_space
    for ours, theirs in zip(episode(mine), episode(same), strict=True):
        np.testing.assert_allclose(ours[0], theirs[0], atol=1e-9)
    assert gym.make(ID, model=path, force_limit=7.0).action_space.high == 7.0


def test_user_model_may_have_what_the_equations_have_not(tmp_path):
    """Dry friction: a hanging cart-pole that is hardly pushed does not move."""
    path = tmp_path / "dry.xml"
    path.write_text(BUILT_IN.read_text().replace('damping="0.1"', 'damping="0.1" frictionloss="2"'))
    ends = {}
    for name, options in {"dry": {"model": path}, "smooth": {}}.items():
        env = MujocoCartPoleSwingUpEnv(**options)
        env.reset(options={"state": np.zeros(4)})
        ends[name] = env.step(np.array([1.0], dtype=np.float32))[4]["state"][0]
    assert abs(ends["dry"]) < 0.05 * ends["smooth"]


def test_user_models_step_must_divide_the_time_of_a_look_or_be_given(tmp_path):
    path = tmp_path / "slow.xml"
    path.write_text(BUILT_IN.read_text().replace('timestep="0.002"', 'timestep="0.004"'))
    with pytest.raises(InputError, match="timestep must divide the 0.01 s"):
        MujocoCartPoleSwingUpEnv(model=path)
    assert MujocoCartPoleSwingUpEnv(model=path, timestep=0.005).simulator.timestep == 0.005


def test_constants_of_the_built_in_model_are_refused_beside_another(unchecked_shapes):
    with pytest.raises(InputError, match="pole_mass, gravity: of the built-in model only"):
        MujocoCartPoleSwingUpEnv(model=BUILT_IN, pole_mass=0.5, gravity=9.82)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cart_mass", 0.0),
        ("pole_mass", "heavy"),
        ("pole_length", -0.5),
        ("cart_friction", -1.0),
        ("force_limit", 0.0),
        ("timestep", 0.0),
        ("timestep", 0.003),
        ("model", "nowhere.xml"),
        ("cost_lengthscales", (1.0,)),
    ],
)
def test_wrong_keyword_value_is_refused_by_name(unchecked_shapes, name, value):
    with pytest.raises(InputError, match=name) as error:
        MujocoCartPoleSwingUpEnv(**{name: value})
    assert str(error.value).endswith(".")


@pytest.mark.slow
def test_importing_envs_does_not_load_mujoco_but_knows_the_id():
    code = (
        "import sys, envs, gymnasium, json; loaded = 'mujoco' in sys.modules;"
        f"gymnasium.make('{ID}'); print(json.dumps([loaded, 'mujoco' in sys.modules]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert json.loads(done.stdout) == [False, True], done.stderr


PILCO = CartPoleDynamics.nominal()
OTHER = CartPoleDynamics.nominal(
    cart_mass=1.3, pole_mass=0.2, pole_length=0.8, cart_friction=0.7, gravity=3.7
)


def simulated(constants: CartPoleDynamics, timestep: float) -> MujocoSimulator:
    model = build_model(cart_pole().where(**vars(constants)))
    model.opt.timestep = timestep
    return MujocoSimulator(model)


def some_states(n: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(n, 4)) * [0.5, 1.0, 2.0, 2.0]


@pytest.mark.parametrize("strength", [0.0, 10.0], ids=["free", "forced"])
@pytest.mark.parametrize(
    ("constants", "low", "high"),
    # of PILCO's constants the terms of order 4 are so small that those of order 5 show beside them
    [(PILCO, 3.7, 5.2), (OTHER, 3.9, 4.1)],
    ids=["pilco", "other"],
)
def test_motion_becomes_the_analytic_one_with_order_4(constants, low, high, strength):
    forces = strength * np.random.default_rng(1).uniform(-1, 1, (10, 20))

    def end(dynamics):
        states = some_states(20)
        for force in forces:
            states = dynamics.advance(states, force, 0.1)[-1]
        return states

    steps = np.array([0.02, 0.01, 0.005, 0.0025])
    analytic = end(constants)
    distances = [np.abs(end(simulated(constants, h)) - analytic).max() for h in steps]
    slope = np.polyfit(np.log(steps), np.log(distances), 1)[0]
    assert low < slope < high
    assert distances[-1] < 1e-6


def test_energy_is_conserved_without_friction_and_force():
    constants = CartPoleDynamics.nominal(cart_friction=0.0)
    states = some_states(20)
    path = simulated(constants, 0.002).advance(states, 0.0, 3.0, samples=30)
    change = constants.energy(path) - constants.energy(states)
    assert 0 < np.abs(change).max() < 1e-6


def test_samples_are_those_of_shorter_motions():
    dynamics, states = simulated(PILCO, 0.002), some_states(3)
    path = dynamics.advance(states, 4.0, 0.1, samples=10)
    assert path.shape == (10, 3, 4)
    for sample in path:
        states = dynamics.advance(states, 4.0, 0.01)[0]
        np.testing.assert_array_equal(sample, states)


def test_batch_is_a_loop_of_single_motions():
    dynamics, states = simulated(OTHER, 0.002), some_states(6)
    forces = np.linspace(-10, 10, 6)
    batch = dynamics.advance(states.reshape(2, 3, 4), forces.reshape(2, 3), 0.1, samples=5)
    assert batch.shape == (5, 2, 3, 4)
    for i in range(6):
        single = dynamics.advance(states[i], forces[i], 0.1, samples=5)
        np.testing.assert_array_equal(batch[:, i // 3, i % 3], single)


def test_motion_depends_on_its_start_and_input_alone():
    dynamics, states = simulated(PILCO, 0.002), some_states(1)
    first = dynamics.advance(states, 3.0, 0.1)
    dynamics.advance(some_states(5), -10.0, 1.0)
    np.testing.assert_array_equal(dynamics.advance(states, 3.0, 0.1), first)
    np.testing.assert_array_equal(copy.deepcopy(dynamics).advance(states, 3.0, 0.1), first)


def test_tip_is_where_the_equations_have_it():
    states = some_states(12).reshape(3, 4, 4)
    tips = simulated(OTHER, 0.002).posture.marker(states)
    # the pole is drawn in front of the cart, so that y differs
    np.testing.assert_allclose(tips[..., ::2], OTHER.tip(states)[..., ::2], atol=1e-12)


def test_unstable_motion_is_told_and_leaves_the_dynamics_usable(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log of its own where it is
    dynamics, states = simulated(PILCO, 0.01), some_states(3)
    before = dynamics.advance(states, 0.0, 0.1)
    wild = states.copy()
    wild[1, 3] = 1e12
    with pytest.raises(EnvError, match="unstable.*timestep") as error:
        dynamics.advance(wild, 0.0, 0.1)
    assert str(wild[1].tolist()) in str(error.value)
    np.testing.assert_array_equal(dynamics.advance(states, 0.0, 0.1), before)


@pytest.mark.parametrize("timestep", [0.003, 0.02, 0.0100001, 1.0])
def test_step_that_does_not_divide_the_time_is_refused_with_one_that_does(timestep):
    with pytest.raises(InputError, match="timestep must divide the 0.01 s") as error:
        count_steps(0.01, timestep)
    proposed = float(str(error.value).split("timestep=")[1].rstrip("."))
    assert count_steps(0.01, proposed) >= 1
    assert proposed == fitting_step(0.01, timestep) <= timestep


@pytest.mark.parametrize(
    ("timestep", "steps"), [(0.01, 1), (0.002, 5), (0.01 / 3, 3), (1e-5, 1000)]
)
def test_steps_are_counted_past_rounding(timestep, steps):
    assert count_steps(0.01, timestep) == steps
