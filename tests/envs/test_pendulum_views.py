"""Where the pendulum is shown, in 3D and in a picture."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from envs.look import BACKGROUND, FIXED_COLOR, INPUT_COLOR, POLE_COLOR, TARGET_COLOR
from envs.pendulum_dynamics import PendulumDynamics
from envs.pendulum_views import picture, scene

DYNAMICS = PendulumDynamics(length=0.8)


def pixels(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Rows and columns of a color."""
    return np.argwhere((image == color).all(axis=-1))


def test_rod_reaches_from_the_hinge_to_the_mass():
    states = np.random.default_rng(0).normal(size=(20, 2)) * 3
    shown = scene(DYNAMICS)
    poses = shown.poses(states)
    half = np.array([0.0, 0.0, shown.shapes["rod"].size[1]])
    along = Rotation.from_quat(poses["rod"].quaternion).apply(half)
    np.testing.assert_allclose(poses["rod"].translation + along, 0.0, atol=1e-12)
    np.testing.assert_allclose(poses["rod"].translation - along, shown.marker(states), atol=1e-12)
    np.testing.assert_allclose(poses["mass"].translation, shown.marker(states), atol=1e-12)


def test_upright_mass_touches_the_target():
    shown = scene(DYNAMICS)
    np.testing.assert_allclose(shown.marker(np.array([-np.pi, 0])), shown.target, atol=1e-12)


def test_every_shape_has_a_pose():
    shown = scene(DYNAMICS)
    poses = shown.poses(np.zeros((5, 2)))
    assert set(poses) == set(shown.shapes)
    assert all(
        p.translation.shape == (5, 3) and p.quaternion.shape == (5, 4) for p in poses.values()
    )


def test_picture_shows_rod_mass_and_target():
    image = picture(DYNAMICS, np.zeros(2))
    assert image.dtype == np.uint8
    for color in (POLE_COLOR, FIXED_COLOR, TARGET_COLOR, BACKGROUND):
        assert len(pixels(image, color)) > 0


def test_mass_is_drawn_where_it_is():
    images = [picture(DYNAMICS, np.array([angle, 0.0])) for angle in (0, np.pi / 2, np.pi)]
    rows, columns = np.transpose([pixels(image, POLE_COLOR).mean(axis=0) for image in images])
    middle = np.array(images[0].shape[:2]) / 2
    assert rows[2] < middle[0] < rows[0]
    assert columns[1] > middle[1] + 50
    assert columns[[0, 2]] == pytest.approx(middle[1], abs=1)


def test_torque_is_drawn_to_its_side():
    assert not len(pixels(picture(DYNAMICS, np.zeros(2)), INPUT_COLOR))
    left, right = (
        pixels(picture(DYNAMICS, np.array([np.pi, 0.0]), push), INPUT_COLOR)[:, 1].mean()
        for push in (-1.0, 1.0)
    )
    assert left < 320 < right
