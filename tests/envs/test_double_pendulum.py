"""Laws of the pendubot and the acrobot."""

from __future__ import annotations

import math

import gymnasium as gym
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from envs.double_pendulum import PendubotEnv
from envs.drawing import BACKGROUND, FIXED_COLOR, INPUT_COLOR, POLE_COLOR, TARGET_COLOR, hanging_end
from envs.plants import acrobot, pendubot
from mcpilco.data import Transitions
from mcpilco.dynamics import PhysicsMean, speed_integration
from mcpilco.plant import plant_for
from mcpilco.policies import SaturatingCost
from mcpilco.typing import InputError
from tests.reference.double_pendulum import PendubotDynamics

IDS = ("mcpilco/Pendubot-v0", "mcpilco/Acrobot-v0")
EACH = pytest.mark.parametrize("name", IDS)
UPRIGHT = (math.pi, 0.0, 0.0, 0.0)


def still(env: gym.Env) -> np.ndarray:
    return np.zeros(env.action_space.shape, dtype=np.float32)


@EACH
def test_defaults_are_those_of_the_docstring(name):
    env = gym.make(name).unwrapped
    dynamics = PendubotDynamics.nominal()
    values = env.swing_up.plant.values
    assert {name: values[name] for name in vars(dynamics)} == vars(dynamics)
    assert (dynamics.upper_mass, dynamics.upper_length) == (0.523, 0.2)
    assert (dynamics.lower_mass, dynamics.lower_length) == (0.626, 0.3)
    assert (dynamics.shoulder_friction, dynamics.elbow_friction) == (0.001, 0.001)
    assert (dynamics.upper_center, dynamics.upper_inertia) == (1.0, 0.523)
    assert (dynamics.lower_center, dynamics.lower_inertia) == (0.852, 0.177)
    assert dynamics.gravity == 9.81
    assert env.task.start_std == (0.01,) * 4
    assert env.swing_up.noise_std == (0.001, 0.02, 0.001, 0.02)
    assert env.task.dt == 0.05
    assert env.action_space.high == np.float32(6.0) == -env.action_space.low
    assert env.task.cost == SaturatingCost((0, 2), (math.pi, 0.0), (1.5, 0.75), (True, True))


def test_lifting_and_falling_take_what_the_docstring_says():
    """Level links weigh on the shoulder; the fastest way to fall doubles in 0.07 s."""
    dynamics = PendubotDynamics.nominal()
    assert sum(dynamics.weights) == pytest.approx(3.82, abs=0.005)
    upright, step = np.array(UPRIGHT), 1e-6
    rows = [dynamics.derivative(upright + step * e, 0.0) / step for e in np.eye(4)]
    fastest = np.linalg.eigvals(np.transpose(rows)).real.max()
    assert math.log(2.0) / fastest == pytest.approx(0.07, abs=0.005)


@EACH
def test_both_links_must_be_upright_for_a_success(name):
    def verdict(*state):
        env = gym.make(name, gravity=0.0, shoulder_friction=0.0, elbow_friction=0.0).unwrapped
        env.reset(options={"state": state})
        for _ in range(20):
            *_, info = env.step(still(env))
        return info["is_success"], info["time_up_s"]

    assert verdict(*UPRIGHT) == (True, pytest.approx(1.0))
    assert verdict(-math.pi, 0.0, 2 * math.pi, 0.0) == (True, pytest.approx(1.0))
    assert verdict(math.pi, 0.0, 0.3, 0.0) == (False, 0.0)  # the lower link leans
    assert verdict(math.pi - 0.3, 0.0, 0.3, 0.0) == (False, 0.0)  # the upper one does
    assert verdict(0.0, 0.0, math.pi, 0.0) == (False, 0.0)


@EACH
def test_every_constant_changes_the_motion(name):
    def end(**options):
        env = gym.make(name, **options).unwrapped
        env.reset(options={"state": [1.0, 1.0, 0.5, -1.0]})
        return env.step(np.array([1.0], dtype=np.float32))[4]["state"]

    dynamics = vars(PendubotDynamics.nominal())
    changes = {constant: 1.1 * value for constant, value in dynamics.items()}
    for constant, value in {**changes, "dt": 0.04, "torque_limit": 0.5}.items():
        assert np.abs(end(**{constant: value}) - end()).max() > 1e-6, constant


@EACH
def test_physics_of_its_plant_leave_nothing_of_its_motion_to_learn(name):
    env = gym.make(name, noise_std=0.0, start_std=[1.0, 3.0, 1.0, 3.0]).unwrapped
    plant = plant_for(env.task, None)
    assert plant.name == name
    physics = PhysicsMean(plant, env.task, speed_integration(env.task), uncertainty=0.0)
    rng, rows = np.random.default_rng(0), []
    for k in range(10):
        before, _ = env.reset(seed=None if k else 0)
        action = rng.uniform(-3.0, 3.0, 1).astype(np.float32)
        rows.append((before, action.astype(float), env.step(action)[0]))
    transitions = Transitions(*map(np.array, zip(*rows, strict=True)))
    moved = np.abs(transitions.next_states - transitions.states).max()
    assert np.abs(physics.residuals(transitions)).max() < 1e-3 * moved


@EACH
@pytest.mark.parametrize(
    ("constant", "value"), [("lower_mass", 0.0), ("elbow_friction", -1.0), ("torque_limit", 0.0)]
)
def test_wrong_keyword_value_is_refused_by_name(name, constant, value):
    with pytest.raises(InputError, match=constant):
        gym.make(name, **{constant: value})


PLANT = pendubot().where(upper_length=0.4)
scene, picture = PendubotEnv.scene_of, PendubotEnv.picture_of
SCENE = scene(PLANT)
UPRIGHT = np.array([np.pi, 0.0, 0.0, 0.0])


def pixels(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Rows and columns of a color."""
    return np.argwhere((image == color).all(axis=-1))


def test_links_reach_from_joint_to_joint():
    states = np.random.default_rng(0).normal(size=(20, 4)) * 3
    shown = SCENE
    poses = shown.poses(states)
    joints = np.zeros((20, 3)), hanging_end(0.4, states[:, 0]), shown.marker(states)
    for link, above, below in (("upper", *joints[:2]), ("lower", *joints[1:])):
        half = np.array([0.0, 0.0, shown.shapes[link].size[1]])
        along = Rotation.from_quat(poses[link].quaternion).apply(half)
        np.testing.assert_allclose(poses[link].translation + along, above, atol=1e-12)
        np.testing.assert_allclose(poses[link].translation - along, below, atol=1e-12)
    np.testing.assert_array_equal(poses["elbow"].translation, joints[1])
    np.testing.assert_array_equal(poses["tip"].translation, joints[2])


def test_upright_tip_touches_the_target():
    shown = SCENE
    np.testing.assert_allclose(shown.marker(UPRIGHT), shown.target, atol=1e-12)


def test_every_shape_has_a_pose():
    shown = SCENE
    poses = shown.poses(np.zeros((5, 4)))
    assert set(poses) == set(shown.shapes)
    assert all(
        p.translation.shape == (5, 3) and p.quaternion.shape == (5, 4) for p in poses.values()
    )


def test_picture_shows_links_and_target():
    image = picture(PLANT, SCENE, np.zeros(4), 0.0)
    assert image.dtype == np.uint8
    for color in (POLE_COLOR, FIXED_COLOR, TARGET_COLOR, BACKGROUND):
        assert len(pixels(image, color)) > 0


def test_lower_link_is_drawn_where_it_is():
    folded = np.array([np.pi, 0.0, np.pi / 2, 0.0])
    images = [picture(PLANT, SCENE, state, 0.0) for state in (np.zeros(4), folded, UPRIGHT)]
    rows, columns = np.transpose([pixels(image, POLE_COLOR).mean(axis=0) for image in images])
    middle = np.array(images[0].shape[:2]) / 2
    assert rows[2] < rows[1] < middle[0] < rows[0]
    assert columns[1] < middle[1] - 20
    assert columns[[0, 2]] == pytest.approx(middle[1], abs=1)


def test_torque_is_drawn_at_its_joint_to_its_side():
    level = np.array([np.pi / 2, 0.0, 0.0, 0.0])
    assert not len(pixels(picture(PLANT, SCENE, level, 0.0), INPUT_COLOR))

    def column(plant, push):
        return pixels(picture(plant, scene(plant), level, push), INPUT_COLOR)[:, 1].mean()

    elbow = acrobot().where(upper_length=0.4)
    assert column(PLANT, -1.0) < 320 < column(PLANT, 1.0) < column(elbow, -1.0)
    assert column(elbow, -1.0) < column(elbow, 1.0)
