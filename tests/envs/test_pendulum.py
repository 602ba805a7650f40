"""Laws of the pendulum env."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import envs
from envs.drawing import BACKGROUND, FIXED_COLOR, INPUT_COLOR, POLE_COLOR, TARGET_COLOR
from envs.pendulum import PendulumEnv
from envs.plants import pendulum
from mcpilco.agent import MCPILCO
from mcpilco.policies import QuadraticCost, SaturatingCost
from mcpilco.typing import InputError

ID = "mcpilco/Pendulum-v0"


def make(**options) -> envs.PendulumEnv:
    return envs.PendulumEnv(**options)


def torque(newton_metre: float) -> np.ndarray:
    return np.array([newton_metre], dtype=np.float32)


def test_defaults_are_those_of_the_docstring():
    env = gym.make(ID).unwrapped
    values = env.swing_up.plant.values
    assert (values["mass"], values["length"]) == (0.6, 0.5)
    assert (values["friction"], values["gravity"]) == (0.05, 9.82)
    assert env.task.start_std == (0.1,) * 2
    assert env.swing_up.noise_std == (0.01,) * 2
    assert env.task.dt == 0.1
    assert env.action_space.high == np.float32(1.2) == -env.action_space.low
    assert env.task.cost == SaturatingCost((0,), (math.pi,), (1.0,), (True,))


def test_task_names_the_state():
    task = make(start_std=[0.1, 0.2]).task
    assert (task.state_names, task.state_units) == (("angle", "velocity"), ("rad", "rad/s"))
    assert (task.input_names, task.input_units) == (("torque",), ("N m",))
    assert (task.angles, task.velocities) == ((0,), ((0, 1),))
    assert (task.start_mean, task.start_std) == ((0.0, 0.0), (0.1, 0.2))


def test_every_constant_changes_the_motion():
    def end(**options):
        env = make(**options)
        env.reset(options={"state": [1.0, 1.0]})
        return env.step(torque(1.0))[4]["state"]

    changes = {
        "mass": 0.7,
        "length": 0.6,
        "friction": 0.1,
        "gravity": 9.0,
        "dt": 0.05,
        "torque_limit": 0.5,
    }
    for name, value in changes.items():
        assert np.abs(end(**{name: value}) - end()).max() > 1e-4, name


def test_info_tells_of_no_cart():
    assert set(make().reset()[1]) == {"state", "is_success", "time_up_s"}


def test_another_cost_is_taken():
    cost = QuadraticCost((np.pi, 0.0), (1.0, 0.1), (0.05,))
    env = make(cost=cost)
    env.reset(options={"state": [np.pi, 0.0]})
    assert env.task.cost == cost
    assert env.step(torque(0.0))[1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mass", 0.0),
        ("length", None),
        ("friction", -1.0),
        ("torque_limit", 0.0),
        ("torque_limit", "strong"),
    ],
)
def test_wrong_keyword_value_is_refused_by_name(unchecked_shapes, name, value):
    with pytest.raises(InputError, match=name) as error:
        make(**{name: value})
    assert str(error.value).endswith(".")


@pytest.mark.parametrize(("limit", "swings"), [(1.0, 4), (1.2, 3), (1.4, 2)])
def test_pendulum_needs_as_many_swings_as_its_docstring_says(limit, swings):
    """The motor always pushes the way that the pendulum moves, which gives it all energy it can."""
    env = make(dt=0.01, torque_limit=limit)
    env.reset(options={"state": [0.0, 0.0]})
    state, turns, time = np.zeros(2), 0, 0.0
    while abs(state[0]) < np.pi:
        before = state[1]
        state = env.step(torque(math.copysign(limit, state[1])))[4]["state"]
        turns += before * state[1] < 0
        time += 0.01
    assert turns + 1 == swings
    assert (time < 3.0) == (limit > 1.0)  # 1 s of the 4 s is needed to hold it


@pytest.mark.slow
def test_default_preset_swings_it_up():
    agent = MCPILCO("SumOfGaussians", ID, seed=1)
    agent.learn(2 * 40)
    while not agent.results[-1].success and len(agent.results) < 4:
        agent.learn(40)
    assert agent.results[-1].success
    assert agent.results[-1].outcome["time_up_s"] > 1.0


PLANT = pendulum().where(length=0.8)
SCENE = PendulumEnv.scene_of(PLANT)
picture = PendulumEnv.picture_of


def pixels(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Rows and columns of a color."""
    return np.argwhere((image == color).all(axis=-1))


def test_rod_reaches_from_the_hinge_to_the_mass():
    states = np.random.default_rng(0).normal(size=(20, 2)) * 3
    shown = SCENE
    poses = shown.poses(states)
    half = np.array([0.0, 0.0, shown.shapes["rod"].size[1]])
    along = Rotation.from_quat(poses["rod"].quaternion).apply(half)
    np.testing.assert_allclose(poses["rod"].translation + along, 0.0, atol=1e-12)
    np.testing.assert_allclose(poses["rod"].translation - along, shown.marker(states), atol=1e-12)
    np.testing.assert_allclose(poses["mass"].translation, shown.marker(states), atol=1e-12)


def test_upright_mass_touches_the_target():
    shown = SCENE
    np.testing.assert_allclose(shown.marker(np.array([-np.pi, 0])), shown.target, atol=1e-12)


def test_every_shape_has_a_pose():
    shown = SCENE
    poses = shown.poses(np.zeros((5, 2)))
    assert set(poses) == set(shown.shapes)
    assert all(
        p.translation.shape == (5, 3) and p.quaternion.shape == (5, 4) for p in poses.values()
    )


def test_picture_shows_rod_mass_and_target():
    image = picture(PLANT, SCENE, np.zeros(2), 0.0)
    assert image.dtype == np.uint8
    for color in (POLE_COLOR, FIXED_COLOR, TARGET_COLOR, BACKGROUND):
        assert len(pixels(image, color)) > 0


def test_mass_is_drawn_where_it_is():
    images = [picture(PLANT, SCENE, np.array([angle, 0.0]), 0.0) for angle in (0, np.pi / 2, np.pi)]
    rows, columns = np.transpose([pixels(image, POLE_COLOR).mean(axis=0) for image in images])
    middle = np.array(images[0].shape[:2]) / 2
    assert rows[2] < middle[0] < rows[0]
    assert columns[1] > middle[1] + 50
    assert columns[[0, 2]] == pytest.approx(middle[1], abs=1)


def test_torque_is_drawn_to_its_side():
    assert not len(pixels(picture(PLANT, SCENE, np.zeros(2), 0.0), INPUT_COLOR))
    left, right = (
        pixels(picture(PLANT, SCENE, np.array([np.pi, 0.0]), push), INPUT_COLOR)[:, 1].mean()
        for push in (-1.0, 1.0)
    )
    assert left < 320 < right
