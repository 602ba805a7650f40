"""Laws of identification from logs: truth is covered, what is not told stays, faults are named."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import mujoco
import numpy as np
import pytest

from mcpilco.identification import (
    NoisyInputConfig,
    Recipe,
    bayesian,
    identify,
    methods,
    projection,
    rigid_body,
    virtual,
)
from mcpilco.typing import InputError
from tests.mcpilco.identification.log import heavier, model, segment


def test_intervals_cover_the_truth_about_as_often_as_they_say():
    truth, inside = rigid_body(heavier(), ("viscous",)), []
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
    truth = found.base.of(rigid_body(heavier(), ("viscous",)).nominal)
    np.testing.assert_allclose(found.beta, truth, atol=2e-3)
    assert np.abs(blind.beta - truth).max() > 0.05


@pytest.mark.filterwarnings("ignore:Objective did not converge")
@pytest.mark.parametrize(
    ("recipe", "where", "name", "cut"),
    [
        (Recipe("OLS"), projection, "_ROUNDS", 2),
        (Recipe("OLS"), projection, "_NEWTON_STEPS", 1),
        (Recipe("OLS", "virtual"), virtual, "_EVALUATIONS", 2),
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
