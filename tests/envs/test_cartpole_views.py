"""Where the cart-pole is shown, in 3D and in a picture."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from envs.cartpole_dynamics import CartPoleDynamics
from envs.cartpole_views import CART_COLOR, picture, scene
from envs.look import BACKGROUND, POLE_COLOR, TARGET_COLOR

DYNAMICS = CartPoleDynamics(pole_length=0.8)


def pixels(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Rows and columns of a color."""
    return np.argwhere((image == color).all(axis=-1))


def test_pole_reaches_from_the_hinge_to_the_tip():
    states = np.random.default_rng(0).normal(size=(20, 4)) * 3
    shown = scene(DYNAMICS)
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
    shown = scene(DYNAMICS)
    np.testing.assert_allclose(shown.marker(np.array([0, 0, -np.pi, 0])), shown.target, atol=1e-12)


def test_every_shape_has_a_pose():
    shown = scene(DYNAMICS)
    poses = shown.poses(np.zeros((5, 4)))
    assert set(poses) == set(shown.shapes)
    assert all(
        p.translation.shape == (5, 3) and p.quaternion.shape == (5, 4) for p in poses.values()
    )


def test_picture_shows_cart_pole_and_target():
    image = picture(DYNAMICS, np.zeros(4))
    assert image.ndim == 3
    assert image.dtype == np.uint8
    for color in (CART_COLOR, POLE_COLOR, TARGET_COLOR, BACKGROUND):
        assert len(pixels(image, color)) > 0


def test_hanging_pole_is_drawn_below_the_cart_and_upright_pole_above():
    middle = picture(DYNAMICS, np.zeros(4)).shape[0] / 2
    hanging = pixels(picture(DYNAMICS, np.zeros(4)), POLE_COLOR)[:, 0].mean()
    upright = pixels(picture(DYNAMICS, np.array([0, 0, np.pi, 0])), POLE_COLOR)[:, 0].mean()
    assert upright < middle < hanging


def test_cart_moves_to_the_right_for_a_positive_position():
    columns = [
        pixels(picture(DYNAMICS, np.array([q1, 0, 0, 0])), CART_COLOR)[:, 1].mean()
        for q1 in (-0.5, 0.0, 0.5)
    ]
    assert columns == sorted(columns)
    assert columns[1] - columns[0] == pytest.approx(columns[2] - columns[1], abs=1)


def test_cart_stays_in_the_picture_however_far_it_goes():
    for q1 in (-40.0, 3.0, 100.0):
        assert len(pixels(picture(DYNAMICS, np.array([q1, 0, 0, 0])), CART_COLOR)) > 0


def test_force_is_drawn():
    still, pushed = (picture(DYNAMICS, np.zeros(4), push) for push in (0.0, 1.0))
    assert (still != pushed).any()
