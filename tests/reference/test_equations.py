"""Laws of every system's equations of motion."""

from __future__ import annotations

import numpy as np
import pytest

from tests.reference.cartpole import CartPoleDynamics
from tests.reference.double_pendulum import AcrobotDynamics, PendubotDynamics
from tests.reference.equations import EquationsOfMotion, _solve
from tests.reference.pendulum import PendulumDynamics

SYSTEMS = pytest.mark.parametrize(
    "dynamics",
    [
        CartPoleDynamics.nominal(cart_friction=0.7),
        PendulumDynamics.nominal(friction=0.2),
        PendubotDynamics.nominal(elbow_friction=0.2),
        AcrobotDynamics.nominal(shoulder_friction=0.2),
    ],
    ids=["cart-pole", "pendulum", "pendubot", "acrobot"],
)


def some_states(dynamics: EquationsOfMotion, n: int) -> tuple[np.ndarray, np.ndarray]:
    """States in any turn, and inputs."""
    rng = np.random.default_rng(0)
    return 3.0 * rng.normal(size=(n, dynamics.width)), rng.uniform(-5, 5, n)


@pytest.mark.parametrize("joints", [1, 2, 3])
def test_solution_is_that_of_a_general_solver(joints):
    rng = np.random.default_rng(joints)
    root, tau = rng.normal(size=(4, 5, joints, joints)), rng.normal(size=(4, 5, joints))
    M = root @ np.swapaxes(root, -1, -2) + np.eye(joints)
    expected = np.linalg.solve(M, tau[..., None])[..., 0]
    np.testing.assert_allclose(_solve(M, tau), expected, rtol=1e-10)


@SYSTEMS
def test_mass_matrix_is_symmetric_and_positive_definite(dynamics):
    M = dynamics.mass_matrix(some_states(dynamics, 100)[0][:, 0::2])
    np.testing.assert_array_equal(M, np.swapaxes(M, -1, -2))
    assert np.linalg.eigvalsh(M).min() > 0


@SYSTEMS
def test_mass_matrix_times_accelerations_are_the_forces(dynamics):
    states, u = some_states(dynamics, 20)
    q, dq = states[:, 0::2], states[:, 1::2]
    M, ddq = dynamics.mass_matrix(q), dynamics.accelerations(q, dq, u)
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", M, ddq), dynamics.forces(q, dq, u), rtol=1e-10, atol=1e-12
    )


@SYSTEMS
def test_forces_at_rest_are_the_slope_of_the_potential(dynamics):
    q, step = some_states(dynamics, 20)[0][:, 0::2], 1e-6
    for joint, side in enumerate(step * np.eye(q.shape[1])):
        slope = (dynamics.potential(q + side) - dynamics.potential(q - side)) / (2 * step)
        force = dynamics.forces(q, np.zeros_like(q), 0.0)[:, joint]
        np.testing.assert_allclose(force, -slope, atol=1e-8)


@SYSTEMS
def test_batch_is_a_loop_of_single_motions(dynamics):
    states, u = some_states(dynamics, 6)
    batch = dynamics.advance(states.reshape(2, 3, -1), u.reshape(2, 3), 0.1, samples=4)
    assert batch.shape == (4, 2, 3, states.shape[1])
    for i in range(6):
        single = dynamics.advance(states[i], u[i], 0.1, samples=4)
        np.testing.assert_allclose(batch[:, i // 3, i % 3], single, rtol=1e-12, atol=1e-12)
