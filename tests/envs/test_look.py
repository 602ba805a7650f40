"""How bodies are turned."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from envs.look import hanging, upright

DOWN = np.array([0.0, 0.0, -1.0])


def test_body_hangs_along_its_pole():
    angle = np.linspace(-7.0, 7.0, 15)
    along = Rotation.from_quat(hanging(angle)).apply(DOWN)
    expected = np.stack([np.sin(angle), np.zeros(15), -np.cos(angle)], axis=-1)
    np.testing.assert_allclose(along, expected, atol=1e-15)


def test_upright_body_is_not_turned():
    np.testing.assert_array_equal(Rotation.from_quat(upright(3)).apply(DOWN), [DOWN] * 3)
