"""Laws of a guessed task: it is true of the env, and where nothing tells there is none."""

from __future__ import annotations

from importlib.util import find_spec

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.spaces import Box

from mcpilco.agent.contract import make_env, task_of
from mcpilco.agent.guess import guess_task, start_of, states_named, velocities_named
from mcpilco.policies import TipCost
from mcpilco.sensing import state_of
from tests.mcpilco.swinging import Swinging

needs_mujoco_envs = pytest.mark.skipif(
    find_spec("imageio") is None, reason="Gymnasium's MuJoCo envs need imageio"
)

SLIDER = """
<mujoco>
  <worldbody>
    <body>
      <joint name="rail" type="slide" axis="1 0 0"/>
      <geom size="0.1"/>
      <body>
        <joint type="hinge" axis="0 1 0"/>
        <geom size="0.1" pos="0 0 0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="rail"/></actuator>
</mujoco>
"""


class Modelled(gym.Env):
    """Shows a MuJoCo model, and observes its positions and velocities, or half of them."""

    dt = 0.02

    def __init__(self, whole: bool = True) -> None:
        self.model = mujoco.MjModel.from_xml_string(SLIDER)
        self.data = mujoco.MjData(self.model)
        self.whole = whole
        self.observation_space = Box(-np.inf, np.inf, (4 if whole else 2,), np.float64)
        self.action_space = Box(-1, 1, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = [0.3, -0.2] + 0.1 * self.np_random.standard_normal(2)
        state = np.concatenate([self.data.qpos, self.data.qvel])
        return state if self.whole else state[:2], {}


def test_a_mujoco_model_tells_joints_angles_and_velocities() -> None:
    guess = guess_task(Modelled())
    task = guess.task
    names = ("rail", "joint_1", "rail_velocity", "joint_1_velocity")
    assert (task.state_names, task.input_names) == (names, ("push",))
    assert task.state_units == ("m", "rad", "m/s", "rad/s")
    assert (task.angles, task.velocities, task.dt) == ((1,), ((0, 2), (1, 3)), 0.02)
    assert task.cost is None
    np.testing.assert_allclose(task.start_mean, [0.3, -0.2, 0, 0], atol=0.06)
    np.testing.assert_allclose(task.start_std, [0.1, 0.1, 0, 0], atol=0.03)
    assert "MuJoCo model" in str(guess)
    assert "rail_velocity of rail" in str(guess)
    assert "learned from the rewards" in str(guess)


def test_a_model_that_is_observed_otherwise_tells_nothing() -> None:
    assert guess_task(Modelled(whole=False)) is None


def test_names_of_observations_tell_angles_and_velocities() -> None:
    env = Swinging("circle")
    assert guess_task(env) is None
    env.observation_names = ("cos_rod_angle", "sin_rod_angle", "rod_velocity")
    env.dt = 0.1
    task = guess_task(env).task
    assert task.state_names == ("rod_angle", "rod_velocity")
    assert task.observed == ((0, 1), 2)
    assert (task.angles, task.velocities) == ((0,), ((0, 1),))
    assert task.start_mean[0] == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        (("x", "cos_a", "sin_a"), {"x": 0, "a": (1, 2)}),
        (("sin(a)", "x", "cos(a)"), {"a": (2, 0), "x": 1}),
        (("a_cos", "a_sin", "cos_b"), {"a": (0, 1), "cos_b": 2}),
    ],
)
def test_cosine_and_sine_of_one_name_are_one_angle(names, columns) -> None:
    assert states_named(names) == columns


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        (("x", "dx"), ((0, 1),)),
        (("pole_velocity", "pole_angle"), ((1, 0),)),
        (("cart_position", "theta", "cart_vel", "theta_dot"), ((0, 2), (1, 3))),
        (("depth", "speed"), ()),
    ],
)
def test_velocities_are_found_by_the_names_of_their_positions(names, pairs) -> None:
    assert velocities_named(names) == pairs


def test_the_start_of_an_angle_is_measured_around_the_circle() -> None:
    rng = np.random.default_rng(0)
    angle = np.pi + 0.1 * rng.standard_normal((400, 1))
    mean, std = start_of((angle + np.pi) % (2 * np.pi) - np.pi, (0,))
    assert abs(mean[0]) == pytest.approx(np.pi, abs=0.02)
    assert std[0] == pytest.approx(0.1, rel=0.1)
    _, around = start_of(rng.uniform(-np.pi, np.pi, (4000, 1)), (0,))
    assert around[0] == pytest.approx(np.pi / np.sqrt(3), rel=0.1)


def test_gymnasiums_pendulum_is_known() -> None:
    env = make_env("Pendulum-v1")
    task = guess_task(env).task
    observation, _ = env.reset(seed=5)
    angle, velocity = env.unwrapped.state
    np.testing.assert_allclose(state_of(task, observation), [angle, velocity], atol=1e-6)
    assert (task.dt, task.velocities) == (0.05, ())
    assert task.cost == TipCost((0,), (1.0,), lengthscale=1.0)


@needs_mujoco_envs
def test_gymnasiums_inverted_double_pendulum_is_known() -> None:
    env = make_env("InvertedDoublePendulum-v5")
    task = guess_task(env).task
    observation, _ = env.reset(seed=5)
    data = env.unwrapped.data
    truth = np.concatenate([data.qpos, data.qvel])
    np.testing.assert_allclose(state_of(task, observation), truth, atol=1e-9)
    assert task.dt == env.unwrapped.dt
    assert isinstance(task.cost, TipCost)
    tip = data.site_xpos[0]
    aside, height = tip[0] - data.qpos[0], tip[2]
    cost = task.cost
    assert sum(cost.lengths) == pytest.approx(1.2)
    lengths = np.array(cost.lengths)
    absolute = np.cumsum(data.qpos[1:])
    assert (lengths * np.sin(absolute)).sum() == pytest.approx(aside, abs=1e-9)
    assert (lengths * np.cos(absolute)).sum() == pytest.approx(height, abs=1e-9)


@needs_mujoco_envs
def test_gymnasiums_inverted_pendulum_is_known() -> None:
    env = make_env("InvertedPendulum-v5")
    task = guess_task(env).task
    assert task.velocities == ((0, 2), (1, 3))
    assert task.dt == env.unwrapped.dt
    assert task.cost is not None


def test_a_guess_is_said_unless_it_is_to_be_quiet(caplog: pytest.LogCaptureFixture) -> None:
    task_of(Modelled(), None, quiet=True)
    assert not caplog.records
    task_of(Modelled(), None)
    assert "The task is guessed from its MuJoCo model" in caplog.text
