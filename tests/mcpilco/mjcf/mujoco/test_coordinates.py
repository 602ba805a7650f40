"""Positions of degrees of freedom and MuJoCo's are the same, and so are distances."""

from __future__ import annotations

import mujoco
import numpy as np

from tests.mcpilco.mjcf.mujoco.models import BOX, plant_of_text


def test_positions_come_back():
    at = plant_of_text(BOX).coordinates
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 9))
    np.testing.assert_allclose(at.positions(at.qpos(q)), q, atol=1e-12)


def test_orientations_differ_as_mj_differentiate_pos_has_it():
    """The difference to a measured state is that of the tangent space, also past half a turn."""
    plant = plant_of_text(BOX)
    rng, J = np.random.default_rng(1), 9
    y, measured = rng.uniform(-1.8, 1.8, (2, 5, 2 * J, 7))
    near = plant.beside(y, measured)
    for b in range(5):
        for t in range(7):
            ours, theirs = (plant.coordinates.qpos(part[b, 0::2, t]) for part in (y, measured))
            expected = np.empty(J)
            mujoco.mj_differentiatePos(plant.model, expected, 1.0, ours, theirs)
            found = (measured - near)[b, 0::2, t]
            np.testing.assert_allclose(found, expected, atol=1e-9)
    np.testing.assert_array_equal(near[:, 1::2], y[:, 1::2])


def test_a_missing_measurement_leaves_a_simulation_as_it_is():
    plant = plant_of_text(BOX)
    y = np.random.default_rng(2).uniform(-1, 1, (1, 18, 3))
    np.testing.assert_array_equal(plant.beside(y, np.full_like(y, np.nan)), y)
