"""Accelerations of joints with soft dry friction satisfy its law, whichever of them stick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

from envs.arms.robots import ur10
from envs.plants import cart_pole, double_pendulum
from mcpilco.bodies import Chain, Chains, accelerations, generalised_forces, scratch, stack
from mcpilco.plant.simulation.soft_friction import SOFT, accelerate_softly

CHAINS = {
    "a cart-pole": cart_pole().chain,
    "a double pendulum": double_pendulum().chain,
    "six joints": ur10(),
}


class Rubbed(NamedTuple):
    """Of `Tables` what accelerations need."""

    chains: Chains
    law: np.ndarray
    joint: np.ndarray
    constants: np.ndarray


@njit(error_model="numpy")
def _accelerate(tables, q, v, w, x, a):
    accelerate_softly(tables, 0, q, v, w, x, a)


def rubbed(chain: Chain, f: np.ndarray, v_r: np.ndarray, t: np.ndarray) -> Rubbed:
    J = len(f)
    constants = np.stack([f, v_r, t, 0.0 * f], 1)[None]
    return Rubbed(stack([chain]), np.full(J, SOFT), np.arange(J), constants)


def found(tables: Rubbed, q: np.ndarray, v: np.ndarray, tau: np.ndarray, guess: np.ndarray):
    x, a = tau.copy(), guess.copy()
    _accelerate(tables, q, v, scratch(len(q)), x, a)
    np.testing.assert_array_equal(x, a)
    return a


@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
def test_the_friction_is_that_of_the_accelerations_it_leads_to(chain):
    """For frictions from far below to far above what moves the joints, and any first guess."""
    rng = np.random.default_rng(0)
    J = len(chain.bodies)
    sticking = []
    for _ in range(300):
        q, v = rng.uniform(-3.0, 3.0, J), rng.normal(size=J) * 10.0 ** rng.uniform(-3.0, 1.0, J)
        tau = 10.0 * rng.normal(size=J)
        f, v_r = 10.0 ** rng.uniform(-1.0, 2.0, J), 10.0 ** rng.uniform(-4.0, -1.0, J)
        t = rng.uniform(0.002, 0.03, J)
        guess = 10.0 ** rng.uniform(-2.0, 4.0) * rng.normal(size=J)
        a = found(rubbed(chain, f, v_r, t), q, v, tau, guess)
        friction = f * np.clip((v + t * a) / v_r, -1.0, 1.0)
        needed = generalised_forces(chain, q[None], v[None], a[None])[0]
        np.testing.assert_allclose(tau - friction, needed, rtol=0.0, atol=1e-6 * (f.max() + 10.0))
        sticking.append(np.mean(np.abs(friction) < f))
    assert 0.2 < np.mean(sticking) < 0.8
    assert np.mean(np.isin(sticking, [0.0, 1.0])) < 0.9, "some stick beside others that slip"


@pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)
def test_a_friction_of_nothing_changes_nothing(chain):
    rng = np.random.default_rng(1)
    q, v, tau = rng.normal(size=(3, len(chain.bodies)))
    none = rubbed(chain, 0.0 * q, 0.0 * q + 1e-3, 0.0 * q + 0.01)
    expected = accelerations(chain, q[None], v[None], tau[None])[0]
    np.testing.assert_allclose(found(none, q, v, tau, 0.0 * q), expected, rtol=1e-9)


def test_without_foresight_it_is_a_force_of_the_velocity_alone():
    chain = cart_pole().chain
    q, v, tau, f = np.array([0.0, 0.5]), np.array([2e-3, -1.0]), np.array([3.0, 0.0]), np.ones(2)
    soft = rubbed(chain, f, np.array([4e-3, 4e-3]), np.zeros(2))
    expected = accelerations(chain, q[None], v[None], tau[None] - [[0.5, -1.0]])[0]
    np.testing.assert_allclose(found(soft, q, v, tau, np.zeros(2)), expected, rtol=1e-12)
