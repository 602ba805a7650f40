"""Where double pendulums are shown, in 3D and in a picture."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from envs.double_pendulum_dynamics import AcrobotDynamics, PendubotDynamics
from envs.double_pendulum_views import picture, scene
from envs.look import BACKGROUND, FIXED_COLOR, INPUT_COLOR, POLE_COLOR, TARGET_COLOR

DYNAMICS = PendubotDynamics(upper_length=0.4)
UPRIGHT = np.array([np.pi, 0.0, 0.0, 0.0])


def pixels(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Rows and columns of a color."""
    return np.argwhere((image == color).all(axis=-1))


def test_links_reach_from_joint_to_joint():
    states = np.random.default_rng(0).normal(size=(20, 4)) * 3
    shown = scene(DYNAMICS)
    poses = shown.poses(states)
    joints = np.zeros((20, 3)), DYNAMICS.elbow(states), shown.marker(states)
    for link, above, below in (("upper", *joints[:2]), ("lower", *joints[1:])):
        half = np.array([0.0, 0.0, shown.shapes[link].size[1]])
        along = Rotation.from_quat(poses[link].quaternion).apply(half)
        np.testing.assert_allclose(poses[link].translation + along, above, atol=1e-12)
        np.testing.assert_allclose(poses[link].translation - along, below, atol=1e-12)
    np.testing.assert_array_equal(poses["elbow"].translation, joints[1])
    np.testing.assert_array_equal(poses["tip"].translation, joints[2])


def test_upright_tip_touches_the_target():
    shown = scene(DYNAMICS)
    np.testing.assert_allclose(shown.marker(UPRIGHT), shown.target, atol=1e-12)


def test_every_shape_has_a_pose():
    shown = scene(DYNAMICS)
    poses = shown.poses(np.zeros((5, 4)))
    assert set(poses) == set(shown.shapes)
    assert all(
        p.translation.shape == (5, 3) and p.quaternion.shape == (5, 4) for p in poses.values()
    )


def test_picture_shows_links_and_target():
    image = picture(DYNAMICS, np.zeros(4))
    assert image.dtype == np.uint8
    for color in (POLE_COLOR, FIXED_COLOR, TARGET_COLOR, BACKGROUND):
        assert len(pixels(image, color)) > 0


def test_lower_link_is_drawn_where_it_is():
    folded = np.array([np.pi, 0.0, np.pi / 2, 0.0])
    images = [picture(DYNAMICS, state) for state in (np.zeros(4), folded, UPRIGHT)]
    rows, columns = np.transpose([pixels(image, POLE_COLOR).mean(axis=0) for image in images])
    middle = np.array(images[0].shape[:2]) / 2
    assert rows[2] < rows[1] < middle[0] < rows[0]
    assert columns[1] < middle[1] - 20
    assert columns[[0, 2]] == pytest.approx(middle[1], abs=1)


def test_torque_is_drawn_at_its_joint_to_its_side():
    level = np.array([np.pi / 2, 0.0, 0.0, 0.0])
    assert not len(pixels(picture(DYNAMICS, level), INPUT_COLOR))

    def column(dynamics, push):
        return pixels(picture(dynamics, level, push), INPUT_COLOR)[:, 1].mean()

    elbow = AcrobotDynamics(upper_length=0.4)
    assert column(DYNAMICS, -1.0) < 320 < column(DYNAMICS, 1.0) < column(elbow, -1.0)
    assert column(elbow, -1.0) < column(elbow, 1.0)
