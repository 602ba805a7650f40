"""Envs that are corrected do what their plant does."""

from __future__ import annotations

import json
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import envs
from envs.plants import PLANTS
from mcpilco.plant import Addition, Correction, correction_of, simulate, write_correction
from mcpilco.plant.simulation.stepper import ACCURACY
from mcpilco.typing import EnvError, InputError
from tests.envs.systems import SYSTEMS

EQUATIONS = [system for system in SYSTEMS if system.id in PLANTS]
each_system = pytest.mark.parametrize("system", EQUATIONS, ids=lambda system: system.id)
"""the envs that take effects"""

SIZES = {
    "viscous_friction": (0.05,),
    "coulomb_friction": (0.2, 0.01),
    "stribeck_friction": (0.2, 0.1, 0.1, 0.01),
    "quadratic_drag": (0.05,),
    "asymmetric_friction": (0.2, 0.1, 0.01),
    "asymmetric_viscous_friction": (0.05, 0.1),
    "load_dependent_friction": (0.2, 0.01),
    "spring": (0.5,),
    "hardening_spring": (0.5,),
    "constant_force": (0.2,),
    "position_ripple": (0.2, 0.1, 7.0),
    "dahl_friction": (0.2, 0.02),
    "back_emf": (0.05, 0.02),
    "elastic_joint": (0.02, 20.0, 0.1),
    "joint_backlash": (0.02, 20.0, 0.5, 0.01),
    "body_mass": (0.05,),
    "center_of_mass": (0.02,),
    "body_inertia": (0.002,),
    "armature": (0.01,),
    "body_length": (0.05,),
    "actuator_gain": (0.9,),
    "actuator_dead_zone": (0.1,),
    "asymmetric_dead_zone": (0.1, 0.2),
    "actuator_saturation": (0.8,),
    "actuator_delay": (0.135,),
    "actuator_lag": (0.06,),
    "actuator_rate_limit": (3.0,),
    "backlash": (0.2,),
    "sensor_offset": (0.02,),
    "sensor_scale": (1.05,),
    "sensor_delay": (0.035,),
    "sensor_lag": (0.03,),
    "eccentric_encoder": (0.1, 0.05),
    "gravity_tilt": (0.05,),
}
FILTERED = 1e-2
"""part of a velocity that differs behind a filter: between two samples it sees a parabola"""
TIMING = [
    ("actuator_delay", "actuator", {"d": 0.035}),
    ("actuator_lag", "actuator", {"T": 0.06}),
    ("backlash", "actuator", {"p": 0.3}),
    ("sensor_delay", None, {"d": 0.013}),
]
"""effects that remember, with their targets; None is the first state"""
DOUBLE = ("mcpilco/Pendubot-v0", "mcpilco/Acrobot-v0")
"""whose plants differ in the motor only, and have many targets"""


def candidates(name):
    """Every effect at every target; of a double pendulum, at the last one of each."""
    found = PLANTS[name]().candidates()
    if name in DOUBLE:
        return list({active.effect.name: active for active in found}.values())
    return found


CANDIDATES = [
    pytest.param(system.id, active, id=f"{system.id[8:-3]}-{active}")
    for system in EQUATIONS
    for active in candidates(system.id)
]


def correction(name, effects):
    plant = PLANTS[name]()
    return Correction(
        name,
        {},
        tuple(Addition(e, t or plant.layout.states[0], values) for e, t, values in effects),
    )


def drive(env, steps, seed=3):
    """Random inputs through an episode: observations, true states, inputs."""
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed)
    observations, states, inputs = [observation], [info["state"]], []
    for _ in range(steps):
        limit = env.action_space.high
        inputs.append(rng.uniform(-limit, limit).astype(np.float32))
        observation, *_, info = env.step(inputs[-1])
        observations.append(observation)
        states.append(info["state"])
    return np.array(observations), np.array(states), np.array(inputs, dtype=float)


def measured(env, plant, start, inputs, past=4):
    """What `simulate` measures after a time without commands.

    It stops at every look, as the env does: where dry friction is strong, a motion depends on the
    steps that it is followed with more than on all else.
    """
    looks, dt = env.swing_up.samples, env.swing_up.dt
    rest, zero = np.zeros((past, 1)), np.zeros(1, dtype=int)
    commands = np.repeat(np.concatenate([rest, inputs]), looks, axis=0)
    commands = np.concatenate([commands, inputs[-1:]])[None]
    tables = plant.tables(plant.nominal[None])
    y = simulate(
        tables, zero, start[None], zero, commands, past * looks, dt / looks, accuracy=ACCURACY
    )
    return y[0].T[::looks]


@each_system
def test_correction_without_effects_moves_as_the_equations(system):
    nothing = Correction(system.id, {}, ())
    _, plain, _ = drive(system.single(), 20)
    _, corrected, _ = drive(system.single(effects=nothing), 20)
    np.testing.assert_allclose(corrected, plain, rtol=0, atol=2e-5)


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("name", "active"), CANDIDATES)
def test_env_with_an_effect_measures_what_the_plant_does(name, active):
    plant = PLANTS[name]().having([(active, SIZES[active.effect.name])])
    env = gym.make(name, effects=correction_of(plant, PLANTS[name]()), noise_std=0.0).unwrapped
    observations, states, inputs = drive(env, 10)
    expected = measured(env, plant, states[0], inputs)
    part = FILTERED if active.effect.name == "sensor_lag" else 0.0
    np.testing.assert_allclose(observations, expected, rtol=part, atol=max(part, 5e-5))


@pytest.mark.one_in(2)
@pytest.mark.parametrize(("name", "active"), CANDIDATES)
def test_every_effect_is_felt(name, active):
    plant = PLANTS[name]().having([(active, SIZES[active.effect.name])])
    env = gym.make(name, effects=correction_of(plant, PLANTS[name]()), noise_std=0.0).unwrapped
    plain = gym.make(name, noise_std=0.0).unwrapped
    assert np.abs(drive(env, 10)[0] - drive(plain, 10)[0]).max() > 2e-3


def test_effects_that_remember_act_together():
    name = "mcpilco/CartPoleSwingUp-v0"
    plant = PLANTS[name]()
    given = correction(name, TIMING)
    env = gym.make(name, effects=given, noise_std=0.0).unwrapped
    observations, states, inputs = drive(env, 10)
    expected = measured(env, env.swing_up.plant, states[0], inputs)
    np.testing.assert_allclose(observations, expected, rtol=0, atol=5e-5)
    assert env.swing_up.plant.name == plant.name


@each_system
def test_sensor_effects_leave_the_true_state_and_the_reward_alone(system):
    state = PLANTS[system.id]().layout.states[0]
    wrong = {"effects": correction(system.id, [("sensor_offset", state, {"o": 0.5})])}
    right = {"effects": Correction(system.id, {}, ())}
    one, other = system.single(**wrong, noise_std=0.0), system.single(**right, noise_std=0.0)
    one.reset(seed=0), other.reset(seed=0)
    seen, reward, *_, info = one.step(system.action(0.5))
    expected, same, *_, truth = other.step(system.action(0.5))
    np.testing.assert_array_equal(info["state"], truth["state"])
    np.testing.assert_allclose(seen - expected, np.eye(system.width)[0] * 0.5, atol=1e-12)
    assert reward == same


@each_system
def test_keywords_are_the_nominal_parameters_of_what_is_corrected(system):
    env = system.single(effects=Correction(system.id, {}, ()), gravity=5.0)
    _, states, _ = drive(env, 10)
    _, expected, _ = drive(system.single(gravity=5.0), 10)
    np.testing.assert_allclose(states, expected, rtol=0, atol=2e-5)


@each_system
def test_corrected_parameters_go_before_keywords_and_are_drawn(system):
    fixed = Correction(system.id, {"gravity": 5.0}, ())
    env = system.single(effects=fixed, gravity=3.0)
    assert env.swing_up.plant.values["gravity"] == 5.0
    _, states, _ = drive(env, 10)
    _, expected, _ = drive(system.single(gravity=5.0), 10)
    np.testing.assert_allclose(states, expected, rtol=0, atol=2e-5)


@each_system
def test_equal_seeds_give_equal_episodes_and_reset_forgets_the_last(system):
    env = system.single(effects=correction(system.id, TIMING))
    first, second = drive(env, 8), drive(env, 8)
    fresh = drive(system.single(effects=correction(system.id, TIMING)), 8)
    for a, b, c in zip(first, second, fresh, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, c)


@each_system
def test_gymnasium_checker_is_content_with_a_corrected_env(system):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized")
        check_env(gym.make(system.id, effects=correction(system.id, TIMING)).unwrapped)


@each_system
def test_vector_env_moves_each_as_the_single_env_across_its_restarts(system):
    options = {"effects": correction(system.id, TIMING), "noise_std": 0.0}
    batch = system.batch(3, max_episode_steps=4, **options)
    single = [system.single(**options) for _ in range(3)]
    _, infos = batch.reset(seed=5)
    starts, rng = infos["state"], np.random.default_rng(0)
    over = np.ones(3, dtype=bool)
    for _ in range(11):
        for env, start, anew in zip(single, starts, over, strict=True):
            if anew:
                env.reset(options={"state": start})
        actions = rng.uniform(-1, 1, (3, 1)).astype(np.float32) * np.float32(system.limit)
        over_before = over = batch._steps >= 4
        observations, *_, infos = batch.step(actions)
        starts = infos["state"]
        for b, env in enumerate(single):
            if not over_before[b]:
                observation, *_ = env.step(actions[b])
                np.testing.assert_array_equal(observations[b], observation)


def test_vector_env_restarts_only_what_is_over():
    system = "mcpilco/Pendulum-v0"
    batch = envs.SwingUpVectorEnv(
        envs.PendulumEnv(effects=correction(system, TIMING), noise_std=0.0), 2
    )
    alone = envs.PendulumEnv(effects=correction(system, TIMING), noise_std=0.0)
    starts = np.array([[0.3, 0.0], [1.0, 0.0]])
    batch.reset(options={"state": starts})
    alone.reset(options={"state": starts[1]})
    for k in range(6):
        if k == 3:
            batch._restart(np.array([True, False]), np.zeros((1, 2)))
        push = np.float32(0.7 if k % 2 else -1.0)
        observations, *_ = batch.step(np.full((2, 1), push))
        np.testing.assert_array_equal(observations[1], alone.step(np.array([push]))[0])


@each_system
def test_file_and_its_content_correct_alike(tmp_path, system):
    given = correction(system.id, TIMING)
    path = write_correction(tmp_path / "corrected.json", given)
    _, expected, _ = drive(system.single(effects=given), 3)
    for effects in (path, str(path), json.loads(path.read_text())):
        env = gym.make(system.id, effects=effects)
        np.testing.assert_array_equal(drive(env, 3)[1], expected)
    batch = gym.make_vec(
        system.id, num_envs=2, vectorization_mode="vector_entry_point", effects=path
    )
    assert batch.unwrapped.swing_up.plant.added


@pytest.mark.parametrize(
    ("effects", "sentence"),
    [
        ("nowhere/corrected.json", "Cannot read nowhere/corrected.json"),
        (7, "effects must be a file such as gap/corrected.json"),
        ({"effects": []}, 'must have "format"'),
        (Correction("mcpilco/Pendulum-v0", {}, ()), "is for the plant 'mcpilco/Pendulum-v0'"),
        (
            Correction(
                "mcpilco/CartPoleSwingUp-v0", {}, (Addition("spring", "wheel", {"k": 1.0}),)
            ),
            "spring cannot act at 'wheel'",
        ),
    ],
)
def test_wrong_effects_get_a_sentence(effects, sentence):
    with pytest.raises(InputError, match=sentence):
        gym.make("mcpilco/CartPoleSwingUp-v0", effects=effects)


def test_motion_that_runs_away_gets_a_sentence():
    name = "mcpilco/Pendulum-v0"
    push = correction(name, [("constant_force", "pendulum", {"f_0": 1e6})])
    env = envs.PendulumEnv(effects=push)
    env.reset(seed=0)
    with pytest.raises(EnvError, match="The motion ran away"):
        env.step(np.zeros(1, dtype=np.float32))
