"""Laws of the recipes: weights, methods, projections."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.identification import (
    Recipe,
    Rows,
    base_parameters,
    check,
    estimate,
    force_errors,
    rigid_body,
    solve,
    zero_phase,
)
from mcpilco.typing import InputError
from tests.mcpilco.identification.log import DT, heavier, segment

BODY = rigid_body(heavier(), ("viscous",))


def rows(noise: float = 0.0, force_noise: float = 0.0, seed: int = 0, cutoff: float = 8.0) -> Rows:
    part = segment(heavier(), seed, noise=noise, force_noise=force_noise)
    nothing, unknown = np.zeros_like(part.q), np.full_like(part.q, np.nan)
    more = noise * np.random.default_rng(99).normal(size=part.q.shape)
    return Rows.of(
        BODY,
        zero_phase(part.q, unknown, part.tau, DT, cutoff),
        zero_phase(more, unknown, nothing, DT, cutoff),
        zero_phase(part.reference, unknown, nothing, DT, cutoff),
    )


def distance(theta: np.ndarray, some: Rows) -> float:
    """Of base parameters, relative to their size."""
    base = base_parameters(some.Y)
    return float(
        np.linalg.norm(base.of(theta - BODY.nominal)) / np.linalg.norm(base.of(BODY.nominal))
    )


CLEAN = rows()


@pytest.mark.parametrize("projection", ["none", "pseudo-inertia"])
@pytest.mark.parametrize("method", ["OLS", "EIV", "IV", "stepwise"])
def test_without_noise_the_true_parameters_are_found(method, projection):
    found = estimate(BODY, CLEAN, Recipe(method, projection))
    assert distance(found.theta, CLEAN) < 5e-3
    if projection == "pseudo-inertia":
        assert all(link.consistent for link in check(BODY, found.theta))


def test_weights_are_the_errors_of_each_joints_forces():
    rng, std = np.random.default_rng(0), np.array([1.0, 0.005])
    noisy = Rows(CLEAN.Y, CLEAN.tau + std * rng.normal(size=CLEAN.tau.shape))
    np.testing.assert_allclose(force_errors(noisy), std, rtol=0.15)
    plain, weighted = (
        CLEAN.tau - CLEAN.Y @ estimate(BODY, noisy, Recipe("OLS", "none", kind)).theta
        for kind in ("plain", "weighted")
    )
    assert weighted[:, 1].std() < 0.5 * plain[:, 1].std()


@pytest.mark.parametrize("method", ["EIV", "IV"])
def test_what_noise_shrinks_is_restored(method):
    noisy = [rows(noise=3e-3, seed=seed, cutoff=30.0) for seed in range(3)]
    errors = {
        name: np.median([distance(estimate(BODY, r, Recipe(name)).theta, r) for r in noisy])
        for name in ("OLS", method)
    }
    assert errors[method] < 0.6 * errors["OLS"]


@pytest.mark.parametrize("method", ["VB b_true", "LASSO"])
def test_units_of_the_forces_do_not_matter(method):
    """Nor is a small inertia taken for none."""
    noisy = rows(noise=2e-4, force_noise=0.05)
    found = [solve(noisy.scaled(np.full(2, scale)), method).b for scale in (1.0, 1e-3, 1e3)]
    for b in found[1:]:
        np.testing.assert_allclose(b, found[0], rtol=1e-3, atol=1e-4)
    left = noisy.tau - noisy.Y @ found[0]
    assert (left.std(axis=0) < 0.1 * noisy.tau.std(axis=0)).all()


def test_a_parameter_that_no_force_depends_on_is_zero():
    unfelt = np.linalg.norm(CLEAN.Y, axis=(0, 1)) < 1e-12
    assert unfelt.any()
    for method in ("OLS", "ridge", "JFA b_true"):
        assert (solve(CLEAN, method).b[unfelt] == 0.0).all()


def test_what_cannot_be_meant_is_told():
    with pytest.raises(InputError, match="method must be one of OLS, .*, IDIM-IV, got 'magic'"):
        Recipe("magic")
    with pytest.raises(InputError, match="projection must be one of none, virtual, pseudo-inertia"):
        Recipe(projection="LMI")
    bare = Rows(CLEAN.Y, CLEAN.tau)
    with pytest.raises(InputError, match="column <joint>_reference"):
        solve(bare, "IV")
    with pytest.raises(InputError, match="IDIM-IV needs a robot to simulate"):
        solve(CLEAN, "IDIM-IV")
    with pytest.raises(InputError, match="noise of the rows"):
        solve(bare, "EIV")
