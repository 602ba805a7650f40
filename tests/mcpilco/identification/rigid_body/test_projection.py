"""Laws of the projection: consistent, nearest, and nothing where nothing is wrong."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.identification import (
    base_parameters,
    check_links,
    project,
    project_virtual,
    pseudo_inertia,
    random_motions,
)
from mcpilco.identification.rigid_body.projection import UNSEEN
from mcpilco.typing import InputError
from tests.mcpilco.identification.rigid_body.arms import arm_body
from tests.mcpilco.identification.rigid_body.links import (
    cost,
    least_eigenvalue,
    random_case,
    random_links,
    solved_by_clarabel,
)

CASES = [(seed, (1, 7, 10)[seed % 3]) for seed in range(200)]


def assert_projected(seed: int, links: int) -> None:
    """Consistent, and at most 0.1 % dearer than any consistent point can be."""
    body, estimate, metric = random_case(np.random.default_rng(seed), links)
    found = project(body, estimate, metric)
    assert least_eigenvalue(body, found.theta) >= -1e-9
    assert found.theta.reshape(links, -1)[:, -1].min() >= 0.0
    assert all(link.consistent for link in check_links(body, found.theta))
    assert found.cost == pytest.approx(cost(found.theta, estimate, metric))
    if found.steps:
        assert found.cost <= 1.001 * lower_bound(body, found.theta, estimate, metric)
    else:
        np.testing.assert_array_equal(found.theta, estimate)


def lower_bound(body, theta, estimate, metric) -> float:
    """A cost that no consistent point is below, by duality; no solver is trusted.

    With Z_k >= 0 and z >= 0, the least of cost - sum <Z_k, J_k> - z f over all theta is one.
    Here they are w times the inverses of J_k and f at a point, w the best.
    """
    blocks = theta.reshape(-1, body.width)
    unit = pseudo_inertia(np.eye(10))
    inverse = np.linalg.inv(metric)
    directions = []
    for block in blocks:
        Z = np.linalg.inv(pseudo_inertia(block[:10]))
        directions.append(np.append(np.einsum("pij,ij->p", unit, Z), 1.0 / block[10]))
    a = np.concatenate(directions)
    # at theta_B + w H^-1 a it is -w a.theta_B - w^2 a H^-1 a / 2
    w = max(-(a @ estimate) / (a @ inverse @ a), 0.0)
    return -w * (a @ estimate) - 0.5 * w * w * (a @ inverse @ a)


@pytest.mark.parametrize(("seed", "links"), CASES[:9])
def test_projections_are_consistent_and_nearest(seed, links):
    assert_projected(seed, links)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "links"), CASES[9:])
def test_more_projections_are_consistent_and_nearest(seed, links):
    assert_projected(seed, links)


@pytest.mark.claim
@pytest.mark.slow
@pytest.mark.parametrize(("seed", "links"), CASES)
def test_costs_are_those_of_a_semidefinite_program(seed, links):
    pytest.importorskip("clarabel")
    body, estimate, metric = random_case(np.random.default_rng(seed), links)
    found = project(body, estimate, metric)
    solved = cost(solved_by_clarabel(body, estimate, metric), estimate, metric)
    size = cost(np.zeros_like(estimate), estimate, metric)
    assert found.cost == pytest.approx(solved, rel=1e-3, abs=1e-12 * size)


def test_a_consistent_estimate_comes_back_unchanged():
    body, _, metric = random_case(np.random.default_rng(0), 7)
    found = project(body, body.nominal, metric)
    np.testing.assert_array_equal(found.theta, body.nominal)
    assert (found.cost, found.gap, found.steps) == (0.0, 0.0, 0)
    again = project(body, project(body, 0.9 * body.nominal - 0.1, metric).theta, metric)
    assert again.steps == 0


def test_what_no_force_depends_on_costs_nothing():
    """The metric of an arm has 48 of 77 directions; least squares leaves the others at 0."""
    body, rng = arm_body(), np.random.default_rng(0)
    Y = body.regressor(*random_motions(body, 60, rng)).reshape(-1, 77)
    base = base_parameters(Y)
    estimate = base.near(
        base.of(body.nominal), np.zeros(len(body.nominal))
    )  # exact, but no body has these
    assert not all(link.consistent for link in check_links(body, estimate))
    found = project(body, estimate, Y.T @ Y)
    assert all(link.consistent for link in check_links(body, found.theta))
    error = Y @ (found.theta - body.nominal)
    assert np.sqrt((error**2).mean()) < 1e-3 * np.sqrt(((Y @ body.nominal) ** 2).mean())


def test_the_projection_of_least_squares_is_nearer_to_the_truth():
    """In the metric of the data, a projection on a convex set that holds the truth is."""
    body, rng = arm_body(), np.random.default_rng(1)
    Y = body.regressor(*random_motions(body, 40, rng)).reshape(-1, 77)
    tau = Y @ body.nominal
    estimate = np.linalg.lstsq(Y, tau + 2.0 * rng.normal(size=len(tau)), rcond=1e-9)[0]
    found = project(body, estimate, Y.T @ Y)
    assert found.steps
    assert cost(found.theta, body.nominal, Y.T @ Y) < cost(estimate, body.nominal, Y.T @ Y)


def test_virtual_parameters_stop_short_of_consistency():
    """They allow principal moments of which one exceeds the sum of the others; no body has such."""
    body, _, metric = random_case(np.random.default_rng(0), 3)
    estimate = body.nominal.copy()
    estimate[body.width + 4] *= 5.0
    np.testing.assert_allclose(project_virtual(body, estimate, metric).theta, estimate, atol=1e-7)
    first, wrong, last = check_links(body, estimate)
    assert first.consistent
    assert last.consistent
    assert "the largest exceeds the sum of the others" in str(wrong)
    found = project(body, estimate, metric)
    assert found.before == (first, wrong, last)
    assert all(link.consistent for link in check_links(body, found.theta))


def test_virtual_parameters_are_never_dearer_than_consistent_ones():
    for seed in range(4):
        body, estimate, metric = random_case(np.random.default_rng(seed), 1)
        found = project_virtual(body, estimate, metric).theta
        faults = [fault for link in check_links(body, found) for fault in link.faults]
        assert all("the largest exceeds the sum of the others" in fault for fault in faults)
        dearer = project(body, estimate, metric).cost
        assert cost(found, estimate, metric) <= 1.0001 * dearer + 1e-12


def test_an_estimate_that_virtual_parameters_can_say_is_kept():
    body, _, metric = random_case(np.random.default_rng(3), 3)
    found = project_virtual(body, body.nominal, metric)
    assert found.converged
    np.testing.assert_allclose(found.theta, body.nominal, atol=1e-8)


def test_a_metric_must_be_one():
    body = random_links(np.random.default_rng(0), 1)
    with pytest.raises(InputError, match="positive semidefinite"):
        project(body, body.nominal, -np.eye(11))
    with pytest.raises(InputError, match="finite"):
        project(body, np.full(11, np.nan), np.eye(11))
    assert 0.0 < UNSEEN < 1e-6
