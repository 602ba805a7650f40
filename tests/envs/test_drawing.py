"""Laws of the painted shapes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from envs.drawing import Canvas, hanging, upright

WHITE, BLACK = (255, 255, 255), (0, 0, 0)


def canvas() -> Canvas:
    """10 units wide and 8 high, a pixel being 0.1."""
    return Canvas(100, 80, 10.0, (0.0, 0.0), WHITE)


def area(painted: Canvas) -> float:
    return (1.0 - painted.image()[..., 0] / 255.0).sum() * 0.01


def test_empty_canvas_is_its_background():
    image = Canvas(100, 80, 10.0, (0.0, 0.0), (1, 2, 3)).image()
    assert image.shape == (80, 100, 3)
    assert image.dtype == np.uint8
    assert (image == (1, 2, 3)).all()


@pytest.mark.parametrize(
    ("shape", "arguments", "expected"),
    [
        ("disc", ((0.3, -0.7), 2.0), np.pi * 4),
        ("line", ((-1.0, -1.0), (2.0, 1.0), 0.5), np.hypot(3, 2) + np.pi / 4),
        ("ring", ((0.0, 0.0), 2.0, 0.5), np.pi * (2.25**2 - 1.75**2)),
        ("box", ((1.0, 0.5), (2.0, 1.0), 0.5), 8 - (4 - np.pi) * 0.25),
    ],
)
def test_painted_area_is_that_of_the_shape(shape, arguments, expected):
    painted = canvas()
    getattr(painted, shape)(*arguments, BLACK)
    assert area(painted) == pytest.approx(expected, rel=0.01)


def test_edges_are_smooth():
    painted = canvas()
    painted.line((-4.0, -1.0), (4.0, 1.5), 0.3, BLACK)
    assert len(np.unique(painted.image())) > 20


def test_x_grows_to_the_right_and_z_grows_upwards():
    painted = canvas()
    painted.disc((3.0, 2.0), 0.5, BLACK)
    row, column = np.argwhere(painted.image()[..., 0] < 128).mean(axis=0)
    assert (row, column) == pytest.approx((39.5 - 20, 49.5 + 30))


def test_arrow_has_its_head_at_its_end():
    painted = canvas()
    painted.arrow((-3.0, 0.0), (3.0, 0.0), 0.2, BLACK)
    heights = (painted.image()[..., 0] < 128).sum(axis=0)
    assert heights[60:85].max() > 2 * heights[25:60].max()


def test_shape_outside_the_picture_leaves_it_unchanged():
    painted = canvas()
    painted.disc((50.0, 0.0), 1.0, BLACK)
    assert area(painted) == 0.0


DOWN = np.array([0.0, 0.0, -1.0])


def test_body_hangs_along_its_pole():
    angle = np.linspace(-7.0, 7.0, 15)
    along = Rotation.from_quat(hanging(angle)).apply(DOWN)
    expected = np.stack([np.sin(angle), np.zeros(15), -np.cos(angle)], axis=-1)
    np.testing.assert_allclose(along, expected, atol=1e-15)


def test_upright_body_is_not_turned():
    np.testing.assert_array_equal(Rotation.from_quat(upright(3)).apply(DOWN), [DOWN] * 3)
