"""Laws of recipes, and of the parameters identified from recordings."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import mujoco
import numpy as np
import pytest

from mcpilco.identification import (
    NoisyInputConfig,
    Recipe,
    RigidBody,
    Rows,
    base_parameters,
    check_links,
    estimate,
    force_errors,
    identify,
    solve,
)
from mcpilco.identification.noisy_inputs import bayesian, methods
from mcpilco.identification.rigid_body import projection
from mcpilco.recordings import zero_phase
from mcpilco.typing import InputError
from tests.mcpilco.identification.rigid_body.log import DT, heavier, model, segment

BODY = RigidBody.of(heavier(), ("viscous",))


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
        assert all(link.consistent for link in check_links(BODY, found.theta))


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


def test_intervals_cover_the_truth_about_as_often_as_they_say():
    truth, inside = RigidBody.of(heavier(), ("viscous",)), []
    for seed in range(6):
        part = segment(heavier(), seed, noise=1e-4, force_noise=0.2)
        found = identify(model(), [part], Recipe(projection="none"), terms=("viscous",))
        off = np.abs(found.beta - found.base.of(truth.nominal))
        inside += list(off <= found.half_width)
    assert np.mean(inside) > 0.8
    assert (found.half_width < 0.5 * np.abs(found.beta).max()).all()


def test_held_out_forces_are_told_better_than_by_the_model_as_it_was():
    parts = [segment(heavier(), seed, noise=2e-4, force_noise=0.05) for seed in (0, 1)]
    found = identify(model(), parts)
    assert (found.error < 0.1 * found.nominal_error).all()
    assert (found.error < 0.05 * found.force).all()
    assert all(link.consistent for link in found.after)


def test_what_no_force_depends_on_stays_as_the_model_says():
    found = identify(model(), [segment(heavier())], Recipe("OLS", "none"), terms=("viscous",))
    dependent = found.base.dependent
    np.testing.assert_array_equal(found.theta[dependent], found.body.nominal[dependent])
    assert "upper_Ixx" in found.report.unidentified
    assert "shoulder_viscous" not in found.report.unidentified


def test_what_is_not_to_be_found_is_taken_from_the_model():
    robot = heavier()
    robot.dof_armature[:] = 0.1
    known = model()
    known.dof_armature[:] = 0.1
    found, blind = (
        identify(given, [segment(robot)], Recipe("OLS", "none"), terms=("viscous",))
        for given in (known, model())
    )
    truth = found.base.of(RigidBody.of(heavier(), ("viscous",)).nominal)
    np.testing.assert_allclose(found.beta, truth, atol=2e-3)
    assert np.abs(blind.beta - truth).max() > 0.05


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Objective did not converge")
@pytest.mark.parametrize(
    ("recipe", "where", "name", "cut"),
    [
        (Recipe("OLS"), projection, "_ROUNDS", 2),
        (Recipe("OLS"), projection, "_NEWTON_STEPS", 1),
        (Recipe("OLS", "virtual"), projection, "_EVALUATIONS", 2),
        (Recipe("LASSO", "none"), methods, "MOST_ITERATIONS", 2),
        pytest.param(
            Recipe("VB b_true", "none"),
            bayesian,
            "NoisyInputConfig",
            partial(NoisyInputConfig, max_iterations=10),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_search_that_was_cut_short_is_told(monkeypatch, recipe, where, name, cut):
    part = segment(heavier(), noise=3e-3, force_noise=1.0, seconds=10.0)

    def told():
        return identify(model(), [part], recipe, terms=("viscous",), cutoff=10.0).report

    whole = told()
    assert whole.converged
    assert whole.iterations > 0
    assert not any("did not converge" in sentence for sentence in whole.warnings)
    monkeypatch.setattr(where, name, cut)
    short = told()
    assert not short.converged
    assert any("did not converge in" in sentence for sentence in short.warnings)


def test_a_closed_form_takes_no_iterations():
    report = identify(model(), [segment(heavier())], Recipe("ridge", "none")).report
    assert (report.converged, report.iterations) == (True, 0)


def test_a_joint_that_stands_still_is_named():
    part = segment(heavier(), noise=1e-4)
    rng = np.random.default_rng(0)
    part.q[:, 1] = 0.3 + 1e-4 * rng.normal(size=len(part.q))
    with pytest.raises(InputError, match="joint 'elbow' must move"):
        identify(model(), [part])


def test_too_little_is_refused():
    with pytest.raises(InputError, match="record for longer"):
        identify(model(), [segment(heavier(), seconds=0.4)])
    with pytest.raises(InputError, match="rows were expected for"):
        identify(model(), [segment(heavier(), seconds=2.0)], cutoff=5.0)
    with pytest.raises(InputError, match="got none"):
        identify(model(), [])
    quiet = replace(segment(heavier()), tau=np.zeros((4000, 2)))
    with pytest.raises(InputError, match="must not all be 0"):
        identify(model(), [quiet])


def test_a_free_joint_is_refused():
    free = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='0.1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(InputError, match="1 free or ball joints"):
        identify(free, [segment(heavier())])
