"""Laws of the env of any MuJoCo model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import envs  # noqa: F401  registers
from envs.model import ModelMotion
from envs.motion import Motion
from mcpilco.typing import InputError

pytestmark = pytest.mark.xdist_group("motions")  # one process compiles what all of them need

PENDULUM = """
<mujoco model="swing">
  <option timestep="0.0005" integrator="RK4"/>
  <worldbody>{floor}
    <body pos="0 0 1">
      <joint name="hinge" axis="0 -1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="0.6"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" ctrlrange="-0.7 1.2"/></actuator>
</mujoco>
"""
FLOOR = '<geom type="plane" size="2 2 0.1"/>'
UP = {"hinge_position": {"target": 3.0, "lengthscale": 2.0, "magnitude": True}}
LATE = [
    {"name": "actuator_delay", "target": "actuator", "parameters": {"d": 0.035}},
    {"name": "quadratic_drag", "target": "hinge", "parameters": {"c": 0.02}},
]


def write(folder: Path, floor: str = "", text: str = PENDULUM) -> Path:
    path = folder / "swing.xml"
    path.write_text(text.format(floor=floor))
    return path


def make(model: Path, **keywords: Any) -> gym.Env:
    return gym.make("mcpilco/Model-v0", model=model, **{"cost": UP, "noise_std": 0.0, **keywords})


def end(env: gym.Env) -> np.ndarray:
    env.reset(seed=0, options={"state": [0.1, 0.0]})
    commands = np.random.default_rng(0).uniform(-0.7, 1.2, (30, 1))
    return np.array([env.step(command)[4]["state"] for command in commands])


def test_gymnasium_finds_no_fault(tmp_path: Path) -> None:
    check_env(make(write(tmp_path)).unwrapped, skip_render_check=True)


def test_mujoco_moves_a_model_as_its_equations_do(tmp_path: Path) -> None:
    """A floor that nothing touches makes MuJoCo the simulator."""
    by_equations, by_mujoco = make(write(tmp_path)), make(write(tmp_path, FLOOR))
    assert type(by_equations.unwrapped._motion) is Motion
    assert type(by_mujoco.unwrapped._motion) is ModelMotion
    np.testing.assert_allclose(end(by_mujoco), end(by_equations), atol=1e-6)


def test_mujoco_moves_a_corrected_model_as_its_equations_do(tmp_path: Path) -> None:
    late = {"format": 1, "plant": "swing", "parameters": {}, "effects": LATE}
    nominal = end(make(write(tmp_path)))
    by_equations = end(make(write(tmp_path), effects=late))
    by_mujoco = end(make(write(tmp_path, FLOOR), effects=late))
    assert np.abs(by_equations - nominal).max() > 0.1
    np.testing.assert_allclose(by_mujoco, by_equations, atol=1e-4)


def test_before_an_episode_every_command_was_0(tmp_path: Path) -> None:
    """Of a motor that is late by a whole step, the first command does nothing in it."""
    delay = {"name": "actuator_delay", "target": "actuator", "parameters": {"d": 0.05}}
    late = {"format": 1, "plant": "swing", "parameters": {}, "effects": [delay]}
    env = make(write(tmp_path, FLOOR), effects=late)
    ends = []
    for command in (-0.7, 1.2):
        env.reset(options={"state": [0.0, 0.0]})
        ends.append([env.step(np.array([command]))[4]["state"] for _ in range(2)])
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    assert abs(ends[0][1][1] - ends[1][1][1]) > 0.1


def test_an_episode_knows_nothing_of_the_one_before(tmp_path: Path) -> None:
    late = {"format": 1, "plant": "swing", "parameters": {}, "effects": LATE}
    env = make(write(tmp_path, FLOOR), effects=late)
    first = end(env)
    env.reset(options={"state": [2.0, 1.0]})
    np.testing.assert_array_equal(end(env), first)


def test_task_names_what_the_model_has(tmp_path: Path) -> None:
    env = make(write(tmp_path), dt=0.1, start_std=(0.1, 0.2), start_mean={"hinge_position": 0.3})
    task = env.unwrapped.task
    assert task.state_names == ("hinge_position", "hinge_velocity")
    assert (task.angles, task.velocities, task.input_units) == ((0,), ((0, 1),), ("N m",))
    assert (task.start_mean, task.start_std, task.dt) == ((0.3, 0.0), (0.1, 0.2), 0.1)
    assert (env.action_space.low[0], env.action_space.high[0]) == (-0.7, 1.2)


def test_reward_is_the_cost_of_the_state_after_the_step(tmp_path: Path) -> None:
    env = make(write(tmp_path))
    env.reset(options={"state": [-2.0, 0.0]})
    _, reward, *_, info = env.step(np.zeros(1))
    away = (abs(info["state"][0]) - 3.0) / 2.0
    assert reward == pytest.approx(np.exp(-(away**2)))


def test_episodes_start_and_are_measured_with_the_spread_asked_for(tmp_path: Path) -> None:
    env = make(write(tmp_path), start_std=0.2, noise_std=(0.1, 0.5))
    seen = [env.reset(seed=k) for k in range(400)]
    states = np.array([info["state"] for _, info in seen])
    noise = np.array([observation for observation, _ in seen]) - states
    np.testing.assert_allclose(states.std(axis=0), 0.2, rtol=0.15)
    np.testing.assert_allclose(noise.std(axis=0), (0.1, 0.5), rtol=0.15)


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"cost": {}}, "cost must give states a goal"),
        ({"cost": {"elbow": {"lengthscale": 1.0}}}, "cost knows hinge_position, hinge_velocity"),
        ({"cost": {"hinge_position": {"target": 1.0}}}, "must have a lengthscale"),
        ({"cost": {"hinge_position": {"lengthscale": 1.0, "goal": 1}}}, "knows target"),
        ({"dt": 0.0}, "dt must be a positive number"),
        ({"start_mean": {"x": 0.0}}, "start_mean knows hinge_position"),
        ({"input_limit": {"x": 1.0}}, "input_limit knows motor"),
        ({"render_mode": "ascii"}, "render_mode must be"),
        ({"model": "none.xml"}, "model must be an MJCF or a URDF file, got 'none.xml'"),
    ],
)
def test_a_wrong_keyword_is_told_in_a_sentence(
    tmp_path: Path, keywords: dict[str, Any], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        make(**{"model": write(tmp_path), **keywords})


def test_a_motor_without_a_range_needs_a_limit(tmp_path: Path) -> None:
    text = PENDULUM.replace(' ctrlrange="-0.7 1.2"', "")
    model = write(tmp_path, text=text)
    with pytest.raises(InputError, match='input_limit, such as {"motor": 1.0}; motor has none'):
        make(model)
    assert make(model, input_limit={"motor": 0.5}).action_space.high[0] == 0.5


def test_a_free_joint_is_refused(tmp_path: Path) -> None:
    text = PENDULUM.replace('<joint name="hinge" axis="0 -1 0" damping="0.05"/>', "<freejoint/>")
    text = text.split("<actuator>")[0] + "</mujoco>"
    with pytest.raises(InputError, match="hinges and slides alone"):
        make(write(tmp_path, text=text))


def test_effects_of_sensors_need_equations(tmp_path: Path) -> None:
    effect = {"name": "sensor_offset", "target": "hinge_position", "parameters": {"o": 0.5}}
    offset = {"format": 1, "plant": "swing", "parameters": {}, "effects": [effect]}
    env = make(write(tmp_path), effects=offset)
    seen, info = env.reset(options={"state": [0.1, 0.0]})
    assert seen[0] == pytest.approx(info["state"][0] + 0.5)
    with pytest.raises(InputError, match="apply effects of sensors to the observations"):
        make(write(tmp_path, FLOOR), effects=offset)
