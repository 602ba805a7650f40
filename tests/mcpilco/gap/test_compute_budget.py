"""A simulation counts its steps, and stages end when their share is used up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import envs
from mcpilco.gap.data import GapProblem
from mcpilco.gap.fit import Fit, fit_model, fit_nominal
from mcpilco.gap.investigation import _fit_all_windows
from mcpilco.gap.plant_model import ComputeBudget
from mcpilco.gap.search import Tried, search
from mcpilco.gap.sensitivities import run
from mcpilco.gap.thresholds import BUDGET
from mcpilco.plant import CATALOGUE, EffectInstance
from tests.mcpilco.gap.pendulum import record

PLANT = envs.PLANTS["mcpilco/Pendulum-v0"]()


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    """Recordings of a pendulum with a drag and a constant torque."""
    rng = np.random.default_rng(0)
    measured = [record(rng, lambda q, v: 0.1 - 0.02 * v * abs(v), number) for number in range(2)]
    return GapProblem.of(PLANT, measured, 0.01, (), {})


def limited(problem: GapProblem, most: float) -> GapProblem:
    return replace(problem, budget=ComputeBudget(most))


def test_a_share_is_a_part_of_the_steps_that_are_left() -> None:
    budget = ComputeBudget(100.0)
    first = budget.share(0.25)
    budget.used[0] = 24
    assert not first.used_up
    budget.used[0] = 60
    assert first.used_up
    assert budget.share(0.5).most == 80.0


def test_commands_that_are_held_shorter_may_take_as_many_more_steps() -> None:
    most = [ComputeBudget.at(held_s, False).most for held_s in (0.1, 0.02)]
    assert most == [ComputeBudget().most] * 2
    assert ComputeBudget.at(0.016, False, 10.0).most == pytest.approx(12.5)
    assert ComputeBudget.at(0.005, False, 10.0).most == pytest.approx(40.0)
    assert ComputeBudget.at(0.005, True, 10.0).most == 10.0


def test_of_an_effort_that_is_spent_every_share_is_used_up() -> None:
    budget = ComputeBudget(100.0)
    budget.used[0] = 130
    assert budget.share(0.9).used_up


def test_equal_simulations_count_equal_steps_and_two_as_many_as_both(problem: GapProblem) -> None:
    windows = problem.windows()[:2]
    counts = []
    for some in (windows[:1], windows[1:], windows, windows):
        model = limited(problem, 1.0).model(windows)
        run(model, some, np.zeros((1, model.nuisances)), some.guess[None])
        counts.append(int(model.budget.used[0]))
    assert counts[0] >= windows.y.shape[2] - 1
    assert counts[0] + counts[1] == counts[2] == counts[3]


def test_a_stiff_friction_counts_for_more(problem: GapProblem) -> None:
    windows = problem.windows()[:4]
    smooth = problem.model(windows)
    nothing, friction = (
        np.zeros(smooth.nuisances),
        EffectInstance(CATALOGUE["coulomb_friction"], "pendulum"),
    )
    counts = []
    for model, theta in ((smooth, nothing), smooth.grown(nothing, friction, [5.0, 1e-3])):
        counted = replace(model, budget=ComputeBudget())
        run(counted, windows, theta[None], windows.guess[None])
        counts.append(int(counted.budget.used[0]))
    assert counts[1] > 2 * counts[0]


def test_a_fit_of_which_no_steps_are_left_makes_one_iteration(problem: GapProblem) -> None:
    windows = problem.windows()
    known, spent = problem.model(windows), limited(problem, 0.0).model(windows)
    theta = np.zeros(known.nuisances)
    once = fit_model(known, windows, theta, windows.guess, iterations=1)
    ended = fit_model(spent, windows, theta, windows.guess)
    whole = fit_model(known, windows, theta, windows.guess)
    assert ended.chi2 == once.chi2
    assert whole.chi2 < ended.chi2


def test_a_stage_has_some_steps_whatever_those_before_have_used() -> None:
    budget = ComputeBudget.at(0.005, False, 10.0)
    assert budget.for_stage().most == budget.used[0] + 4.0 * BUDGET.stage_steps
    assert ComputeBudget(1e9).for_stage().most == 1e9
    spent = ComputeBudget(100.0)
    spent.used[0] = 130
    assert spent.for_stage().most == 130 + BUDGET.stage_steps


def test_hints_of_a_search_that_spent_its_steps_are_fitted_with_those_of_the_next(
    problem: GapProblem,
) -> None:
    windows = problem.windows()[::2]
    drag = EffectInstance(CATALOGUE["quadratic_drag"], "pendulum")
    null, windows = fit_nominal(problem.model(windows), windows)
    spent = null.allowed(limited(problem, 0.0).budget)
    model, theta = spent.model.grown(spent.theta, drag, [1e-3])
    hint = fit_model(model, windows, theta, spent.x0)
    assert hint.model.budget.used_up
    fitted = Tried.begun(null, windows, [drag]).following([hint]).fits[frozenset({drag})]
    assert not fitted.model.budget.used_up


def test_the_last_fit_converges_though_the_search_has_used_all_steps(problem: GapProblem) -> None:
    windows = problem.windows()
    null = fit_model(
        problem.model(windows), windows, np.zeros(problem.model(windows).nuisances), windows.guess
    )
    drag = EffectInstance(CATALOGUE["quadratic_drag"], "pendulum")
    model, theta = null.model.grown(null.theta, drag, [1e-3])
    found = []
    for each in (problem, limited(problem, 0.0)):
        begun = Fit(replace(model, budget=each.budget), theta, null.x0, null.by_window)
        found.append(_fit_all_windows(each, begun, windows, windows[:0])[0])
    enough, spent = found
    np.testing.assert_allclose(spent.theta, enough.theta, rtol=1e-6)


@pytest.mark.slow
def test_a_search_of_few_steps_ends_when_these_are_used(problem: GapProblem) -> None:
    windows = problem.windows()[::3]
    candidates = problem.candidates(windows)[::2]
    whole = search(limited(problem, 1e9).model(windows), windows, candidates)
    few = int(whole.best.model.budget.used[0]) // 2
    part = search(limited(problem, few).model(windows), windows, candidates)
    again = search(limited(problem, few).model(windows), windows, candidates)
    assert len(part.ranked) > 1
    taken, all_that_it_asks = (int(each.best.model.budget.used[0]) for each in (part, whole))
    assert BUDGET.search * few < taken < 0.8 * all_that_it_asks
    assert [bic for _, bic in part.ranked] == [bic for _, bic in again.ranked]
