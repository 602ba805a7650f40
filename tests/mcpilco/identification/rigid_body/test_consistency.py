"""Laws of pseudo-inertias, of virtual parameters, and of what is said of a link."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.identification import check_links, from_virtual, pseudo_inertia, to_virtual
from mcpilco.identification.rigid_body.consistency import from_pseudo_inertia
from tests.mcpilco.identification.rigid_body.links import random_links


def test_a_pseudo_inertia_is_the_second_moment_of_masses():
    rng = np.random.default_rng(0)
    points, masses = rng.normal(size=(5, 3)), rng.uniform(0.1, 1.0, 5)
    raised = np.column_stack([points, np.ones(5)])
    J = np.einsum("p,pi,pj->ij", masses, raised, raised)
    inertia = sum(
        m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(masses, points, strict=True)
    )
    theta = np.concatenate([[masses.sum()], masses @ points, inertia[np.triu_indices(3)]])
    np.testing.assert_allclose(pseudo_inertia(theta), J, atol=1e-14)
    np.testing.assert_allclose(from_pseudo_inertia(J), theta, atol=1e-14)


def test_virtual_parameters_are_those_of_the_printed_equation():
    """Eq. (5) written out, with the names of the seed."""
    v = np.random.default_rng(1).normal(size=(20, 10))
    m = v[:, 0] ** 2
    printed = [
        m,
        *(v[:, k] * m for k in (1, 2, 3)),
        v[:, 4] ** 2 + (v[:, 3] ** 2 + v[:, 2] ** 2) * m,
        v[:, 4] * v[:, 5] - v[:, 1] * v[:, 2] * m,
        v[:, 4] * v[:, 6] - v[:, 1] * v[:, 3] * m,
        v[:, 5] ** 2 + v[:, 7] ** 2 + (v[:, 1] ** 2 + v[:, 3] ** 2) * m,
        v[:, 5] * v[:, 6] + v[:, 7] * v[:, 8] - v[:, 2] * v[:, 3] * m,
        v[:, 6] ** 2 + v[:, 8] ** 2 + v[:, 9] ** 2 + (v[:, 1] ** 2 + v[:, 2] ** 2) * m,
    ]
    np.testing.assert_allclose(from_virtual(v), np.stack(printed, axis=1), atol=1e-12)


def test_virtual_parameters_are_found_again():
    v = np.random.default_rng(2).uniform(0.5, 1.5, (20, 10))
    np.testing.assert_allclose(to_virtual(from_virtual(v)), v, rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({0: -0.2}, "mass -0.2 kg is not positive"),
        ({4: -0.5}, "one is negative"),
        ({9: 9.0}, "the largest exceeds the sum of the others"),
        ({10: -0.3}, "viscous -0.3 is negative"),
    ],
)
def test_what_is_wrong_is_said_link_by_link(changes, said):
    body = random_links(np.random.default_rng(0), 3)
    theta = body.nominal.copy()
    for place, value in changes.items():
        theta[body.width + place] = value
    first, wrong, last = check_links(body, theta)
    assert first.consistent
    assert last.consistent
    assert not wrong.consistent
    assert wrong.name == "link1"
    assert said in str(wrong)


def test_bodies_that_exist_are_consistent():
    body = random_links(np.random.default_rng(5), 10)
    assert all(link.consistent for link in check_links(body, body.nominal))


def test_a_thin_rod_and_a_point_are_bodies():
    body = random_links(np.random.default_rng(0), 2)
    theta = body.nominal.reshape(2, -1).copy()
    theta[0, :10] = [1.0, 0.0, 0.0, 0.5, 1 / 3, 0.0, 0.0, 1 / 3, 0.0, 0.0]
    theta[1, :10] = 0.0
    assert all(link.consistent for link in check_links(body, theta.ravel()))
