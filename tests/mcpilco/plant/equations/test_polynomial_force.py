"""Forces that are polynomials of the motion: those of the kernel GIP, in the forward dynamics."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from envs.plants import cart_pole
from mcpilco.dynamics import JointPolynomials
from mcpilco.kernels import GIP, Monomials
from mcpilco.plant.equations.chain import (
    LEAST_INERTIA,
    PolynomialForces,
    accelerations,
    accelerations_with,
    inverse_dynamics,
    mass_matrix,
)
from mcpilco.plant.equations.step import numbers_of, step_of
from tests.mcpilco.plant.equations.test_chain import system
from tests.mcpilco.plant.equations.test_step import task_of
from tests.mcpilco.random_chains import random_planar_chain

KINDS = [("slide", "hinge"), ("hinge", "slide"), ("hinge", "hinge"), ("slide",)]


def every_term(kinds) -> tuple[Monomials, list[tuple[int, tuple[int, ...]]]]:
    """All features of a kernel, and each as a term of each joint."""
    features = Monomials.of(GIP(kinds, (len(kinds),)).terms())
    monomials = [tuple(e - 1 for e in row if e > 0) for row in features.entries.T.tolist()]
    return features, [(j, monomial) for j in range(len(kinds)) for monomial in monomials]


@pytest.mark.parametrize("kinds", KINDS)
def test_the_forces_are_the_features_of_the_kernel(kinds):
    rng, J = np.random.default_rng(0), len(kinds)
    features, terms = every_term(kinds)
    weights = rng.normal(size=(J, len(terms) // J))
    motion = rng.normal(size=(5, 3 * J))
    with torch.no_grad():
        phi = features(JointPolynomials(kinds)(torch.from_numpy(motion))[:, None, None, :])
        expected = (phi / features.roots[:, None] * torch.from_numpy(weights)[:, None]).sum(-1)
    forces = PolynomialForces(kinds, terms, (math.inf,) * J)
    for n, (q, v, a) in enumerate(motion.reshape(5, 3, J)):
        R, s = forces(q.tolist(), v.tolist(), weights.ravel().tolist())
        np.testing.assert_allclose(np.array(R) @ a + s, expected[n, :, 0], rtol=1e-12)


@pytest.mark.parametrize("symmetric", [True, False])
def test_forward_then_inverse_dynamics_is_the_identity(symmetric):
    rng = np.random.default_rng(1)
    chain = random_planar_chain(rng, 3)
    known = system(chain)
    for _ in range(5):
        q, v, tau = rng.normal(size=(3, 3)).tolist()
        R = 0.05 * rng.normal(size=(3, 3)) * np.trace(mass_matrix(known, q)) / 3
        R = R @ R.T if symmetric else R @ R.T + (R - R.T) / 2
        found = accelerations_with(known, q, v, tau, R.tolist())
        again = inverse_dynamics(known, q, v, found, known.gravity) + R @ found
        np.testing.assert_allclose(again, tau, rtol=1e-8, atol=1e-8)
        without = accelerations_with(known, q, v, tau, np.zeros((3, 3)).tolist())
        np.testing.assert_allclose(without, accelerations(known, q, v, tau), rtol=1e-8)


def test_what_takes_all_inertia_leaves_some():
    known = system(random_planar_chain(np.random.default_rng(2), 1))
    (inertia,), rest = mass_matrix(known, [0.3])[0], [0.0]
    at_rest = inverse_dynamics(known, [0.3], rest, rest, known.gravity)[0]
    for taken in (1.0, 1.5, 100.0):
        (found,) = accelerations_with(known, [0.3], rest, [2.0], [[-taken * inertia]])
        np.testing.assert_allclose(found, (2.0 - at_rest) / (LEAST_INERTIA * inertia))


def test_weights_that_are_zero_change_nothing():
    plant, rng = cart_pole(), np.random.default_rng(3)
    task = task_of(plant)
    _, terms = every_term(("slide", "hinge"))
    alone, both = (
        step_of(plant, task, 0.025, missing=forces)
        for forces in (None, PolynomialForces(("slide", "hinge"), terms, (1e4, 1e4)))
    )
    given = torch.from_numpy(rng.normal(size=(7, 5)))
    own = torch.from_numpy(numbers_of(plant, alone.slots, np.tile(plant.nominal, (7, 1))))
    zeros = given.new_zeros(7, len(terms))
    found = both.program(torch.cat([given, own, zeros], 1))
    expected = alone.program(torch.cat([given, own], 1))
    torch.testing.assert_close(found, expected, rtol=1e-10, atol=1e-12)
