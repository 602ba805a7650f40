"""The plants of the envs: the same systems, in the same names and numbers."""

from __future__ import annotations

import numpy as np
import pytest

import envs
from envs.mujoco_cartpole import MujocoCartPoleSwingUpEnv
from envs.plants import PLANTS, double_pendulum
from mcpilco.bodies import accelerations
from tests.reference import REFERENCES

DYNAMICS = {name: REFERENCES[name] for name in PLANTS if name in REFERENCES}


@pytest.mark.parametrize("name", PLANTS)
def test_a_plant_is_called_by_its_id(name):
    assert PLANTS[name]().name == name


@pytest.mark.parametrize("name", PLANTS)
def test_states_have_names_and_units_and_angles_are_in_rad(name):
    layout, angles = PLANTS[name]().layout, PLANTS[name]().angles
    assert len(set(layout.states)) == len(layout.units)
    for position, rate in zip(layout.units[0::2], layout.units[1::2], strict=True):
        assert rate == f"{position}/s"
    assert [i for i, unit in enumerate(layout.units) if unit == "rad"] == list(angles)


@pytest.mark.parametrize(
    "env",
    [envs.CartPoleSwingUpEnv, envs.PendulumEnv, envs.PendubotEnv, MujocoCartPoleSwingUpEnv],
)
def test_docstring_has_the_numbers_of_the_plant(env):
    """Each line of its table of arguments that is a parameter of the plant."""
    values = env().swing_up.plant.values
    rows = [[cell.strip(" `") for cell in line.split("|")] for line in env.__doc__.split("\n")]
    told = {row[1]: float(row[3]) for row in rows if len(row) == 6 and row[1] in values}
    assert told == {name: value for name, value in values.items() if not name.endswith("_gain")}


@pytest.mark.parametrize("name", DYNAMICS)
def test_a_plant_moves_as_its_env_does(name):
    plant, dynamics = PLANTS[name](), DYNAMICS[name]
    rng = np.random.default_rng(0)
    start = rng.normal(size=(4, len(plant.layout.states)))
    force = rng.uniform(-2, 2, 4)
    found = plant.simulate(start, np.tile(force[:, None, None], (1, 10, 1)), 0.02)
    expected = dynamics.advance(start, force, 0.2, samples=10).swapaxes(0, 1)
    np.testing.assert_allclose(found[:, 1:], expected, rtol=0.0, atol=1e-5)


@pytest.mark.parametrize("shape", [(0.5, 1 / 12, 0.5, 1 / 12), (0.9, 0.3, 0.8, 0.2)])
def test_a_double_pendulum_moves_by_lagranges_equations(shape):
    """Written for absolute angles a, b = a + elbow of two rods, r and i relative to l and m l^2.

    (m1 (r1^2 + i1) + m2) l1^2 a'' + m2 l1 r2 l2 cos(a - b) b''
        = t1 - t2 - m2 l1 r2 l2 sin(a - b) b'^2 - (m1 r1 + m2) g l1 sin a
    m2 (r2^2 + i2) l2^2 b'' + m2 l1 r2 l2 cos(a - b) a''
        = t2 + m2 l1 r2 l2 sin(a - b) a'^2 - m2 g r2 l2 sin b
    """
    names = "upper_center", "upper_inertia", "lower_center", "lower_inertia"
    plant = double_pendulum().where(
        upper_mass=0.7, lower_mass=0.5, upper_length=0.4, **dict(zip(names, shape, strict=True))
    )
    r1, i1, r2, i2 = shape
    values = {parameter.name: parameter.value for parameter in plant.parameters}
    m1, m2, l1, l2, g = 0.7, 0.5, 0.4, values["lower_length"], 9.82
    rng = np.random.default_rng(1)
    q, dq, tau = rng.normal(0, 2, (3, 20, 2))
    found = accelerations(plant.build(values), q, dq, tau)
    (a, b), (da, db) = (x.cumsum(axis=1).T for x in (q, dq))
    dda, ddb = found.cumsum(axis=1).T
    c, s = m2 * l1 * r2 * l2 * np.cos(a - b), m2 * l1 * r2 * l2 * np.sin(a - b)
    first = (m1 * (r1**2 + i1) + m2) * l1**2 * dda + c * ddb + s * db**2
    first += (m1 * r1 + m2) * g * l1 * np.sin(a)
    second = m2 * (r2**2 + i2) * l2**2 * ddb + c * dda - s * da**2 + m2 * g * r2 * l2 * np.sin(b)
    np.testing.assert_allclose(first, tau[:, 0] - tau[:, 1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(second, tau[:, 1], rtol=1e-9, atol=1e-9)
