"""Laws of the cart-pole env."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import envs
from envs.cartpole import CART_COLOR, CartPoleSwingUpEnv
from envs.drawing import BACKGROUND, POLE_COLOR, TARGET_COLOR
from envs.plants import cart_pole
from mcpilco.policies import QuadraticCost, SaturatingCost, cart_pole_cost
from mcpilco.typing import InputError

ID = "mcpilco/CartPoleSwingUp-v0"


def make(**options) -> envs.CartPoleSwingUpEnv:
    return envs.CartPoleSwingUpEnv(**options)


def force(newton: float) -> np.ndarray:
    return np.array([newton], dtype=np.float32)


def test_defaults_are_those_of_pilco():
    env = gym.make(ID).unwrapped
    values = env.swing_up.plant.values
    assert (values["cart_mass"], values["pole_mass"], values["pole_length"]) == (0.5, 0.5, 0.5)
    assert (values["cart_friction"], values["gravity"]) == (0.1, 9.82)
    assert env.task.start_std == (0.1,) * 4
    assert env.swing_up.noise_std == (0.01,) * 4
    assert env.task.dt == 0.1
    assert env.task.cost == cart_pole_cost()
    assert (env.action_space.low, env.action_space.high) == (-10.0, 10.0)
    assert env.action_space.dtype == np.float32


def test_task_names_the_state():
    task = make(start_std=[0.1, 0.2, 0.3, 0.4]).task
    assert task.state_names == ("cart_position", "cart_velocity", "pole_angle", "pole_velocity")
    assert task.state_units == ("m", "m/s", "rad", "rad/s")
    assert (task.input_names, task.input_units) == (("force",), ("N",))
    assert (task.angles, task.velocities) == ((2,), ((0, 1), (2, 3)))
    assert task.start_mean == (0.0,) * 4
    assert task.start_std == (0.1, 0.2, 0.3, 0.4)


def test_every_constant_changes_the_motion():
    def end(**options):
        env = make(**options)
        env.reset(options={"state": [0.0, 1.0, 1.0, 0.0]})
        return env.step(force(3.0))[4]["state"]

    changes = {
        "cart_mass": 0.6,
        "pole_mass": 0.6,
        "pole_length": 0.6,
        "cart_friction": 0.2,
        "gravity": 9.0,
        "dt": 0.05,
        "force_limit": 2.0,
    }
    for name, value in changes.items():
        assert np.abs(end(**{name: value}) - end()).max() > 1e-4, name


@pytest.mark.parametrize(
    ("cost", "width"),
    [
        (None, None),
        (None, (1.0, 3.0)),
        (QuadraticCost((0.0, 0.0, 3.0, 0.0), (1.0, 0.1, 2.0, 0.0), (0.05,)), None),
    ],
    ids=["default", "lengthscales", "quadratic"],
)
def test_reward_is_1_minus_cost_of_the_true_state_and_the_force_held(cost, width):
    options = {} if width is None else {"cost_lengthscales": width}
    env = make(cost=cost, **options)
    judged = cost or cart_pole_cost(*(width or (1.5, 1.0)))
    env.reset(seed=1)
    for newton in (3.3, -10.0, 50.0):
        action = force(newton)
        _, reward, *_, info = env.step(action)
        held = torch.tensor(np.clip(action, -10, 10), dtype=torch.float64)
        assert reward == 1.0 - judged(torch.tensor(info["state"]), held).item()


def test_default_cost_is_the_thesis_cost():
    assert make(cost_lengthscales=[1.0, 3.0]).task.cost == cart_pole_cost(1.0, 3.0)
    assert isinstance(make().task.cost, SaturatingCost)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cart_mass", 0.0),
        ("pole_mass", None),
        ("pole_length", -0.5),
        ("cart_friction", -1.0),
        ("force_limit", 0.0),
        ("cost_lengthscales", (1.0,)),
        ("cost_lengthscales", (1.0, 0.0)),
    ],
)
def test_wrong_keyword_value_is_refused_by_name(unchecked_shapes, name, value):
    with pytest.raises(InputError, match=name) as error:
        make(**{name: value})
    assert str(error.value).endswith(".")


def test_cost_and_lengthscales_exclude_each_other():
    with pytest.raises(InputError, match="not both"):
        make(cost=cart_pole_cost(), cost_lengthscales=(1.0, 1.0))


def test_mean_distance_of_the_cart_is_told():
    # at rest upright and without force cart and pole stay where they are
    env = make()
    _, info = env.reset(options={"state": [0.5, 0, -np.pi, 0]})
    assert info["mean_abs_cart_m"] == 0.0
    for _ in range(15):
        *_, info = env.step(force(0.0))
        assert info["mean_abs_cart_m"] == pytest.approx(0.5, abs=1e-3)


def test_positions_are_those_of_the_fully_measured_env_with_its_noise():
    whole, part = gym.make(ID), gym.make("mcpilco/CartPoleSwingUpPositions-v0")
    many = gym.make_vec("mcpilco/CartPoleSwingUpPositions-v0", 3)
    assert part.observation_space.shape == (2,)
    assert many.reset(seed=4)[0].shape == (3, 2)
    seen, info = part.reset(seed=4)
    np.testing.assert_array_equal(seen, whole.reset(seed=4)[0][[0, 2]])
    for _ in range(3):
        seen, *_, info = part.step(force(5.0))
        np.testing.assert_array_equal(seen, whole.step(force(5.0))[0][[0, 2]])
    assert info["state"].shape == (4,)
    task = part.unwrapped.task
    assert (task.measured, task.measurement_std) == ((0, 2), (0.01, 0.01))


def test_without_noise_the_task_leaves_it_to_be_estimated():
    assert make(measured="positions", noise_std=0.0).task.measurement_std is None


def test_another_measured_is_refused():
    with pytest.raises(InputError, match='must be "all" or "positions", got \'angles\''):
        make(measured="angles")


PLANT = cart_pole().where(pole_length=0.8)
SCENE = CartPoleSwingUpEnv.scene_of(PLANT)
picture = CartPoleSwingUpEnv.picture_of


def pixels(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Rows and columns of a color."""
    return np.argwhere((image == color).all(axis=-1))


def test_pole_reaches_from_the_hinge_to_the_tip():
    states = np.random.default_rng(0).normal(size=(20, 4)) * 3
    shown = SCENE
    poses = shown.poses(states)
    half = np.array([0.0, 0.0, shown.shapes["pole"].size[1]])
    rotation = Rotation.from_quat(poses["pole"].quaternion)
    np.testing.assert_allclose(
        poses["pole"].translation - rotation.apply(half), shown.marker(states), atol=1e-12
    )
    np.testing.assert_allclose(
        poses["pole"].translation + rotation.apply(half), poses["cart"].translation, atol=1e-12
    )


def test_upright_pole_at_the_origin_touches_the_target():
    shown = SCENE
    np.testing.assert_allclose(shown.marker(np.array([0, 0, -np.pi, 0])), shown.target, atol=1e-12)


def test_every_shape_has_a_pose():
    shown = SCENE
    poses = shown.poses(np.zeros((5, 4)))
    assert set(poses) == set(shown.shapes)
    assert all(
        p.translation.shape == (5, 3) and p.quaternion.shape == (5, 4) for p in poses.values()
    )


def test_picture_shows_cart_pole_and_target():
    image = picture(PLANT, SCENE, np.zeros(4), 0.0)
    assert image.ndim == 3
    assert image.dtype == np.uint8
    for color in (CART_COLOR, POLE_COLOR, TARGET_COLOR, BACKGROUND):
        assert len(pixels(image, color)) > 0


def test_hanging_pole_is_drawn_below_the_cart_and_upright_pole_above():
    middle = picture(PLANT, SCENE, np.zeros(4), 0.0).shape[0] / 2
    hanging = pixels(picture(PLANT, SCENE, np.zeros(4), 0.0), POLE_COLOR)[:, 0].mean()
    upright = pixels(picture(PLANT, SCENE, np.array([0, 0, np.pi, 0]), 0.0), POLE_COLOR)[
        :, 0
    ].mean()
    assert upright < middle < hanging


def test_cart_moves_to_the_right_for_a_positive_position():
    columns = [
        pixels(picture(PLANT, SCENE, np.array([q1, 0, 0, 0]), 0.0), CART_COLOR)[:, 1].mean()
        for q1 in (-0.5, 0.0, 0.5)
    ]
    assert columns == sorted(columns)
    assert columns[1] - columns[0] == pytest.approx(columns[2] - columns[1], abs=1)


def test_cart_stays_in_the_picture_however_far_it_goes():
    for q1 in (-40.0, 3.0, 100.0):
        assert len(pixels(picture(PLANT, SCENE, np.array([q1, 0, 0, 0]), 0.0), CART_COLOR)) > 0


def test_force_is_drawn():
    still, pushed = (picture(PLANT, SCENE, np.zeros(4), push) for push in (0.0, 1.0))
    assert (still != pushed).any()
