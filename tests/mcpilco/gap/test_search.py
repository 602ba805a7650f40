"""How sets of effects are searched, judged and exchanged."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest

import envs
from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.fit import Fit
from mcpilco.gap.screen import Score
from mcpilco.gap.search import (
    Criterion,
    SearchResult,
    Tried,
    exchanged,
    grow,
    plainer,
    search,
    without,
)
from mcpilco.gap.thresholds import SEARCH
from tests.mcpilco.gap.lagging import active, fitted, problem, recorded

STD = {"m": 1e-3, "rad": 2e-3}


def test_an_effect_that_stands_for_another_is_exchanged(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    _, windows, null = lagging
    names = "actuator_delay", "actuator_lag", "actuator_dead_zone"
    candidates = [active(name, "actuator") for name in names]
    model, theta = null.model.grown(null.theta, candidates[0], [0.05])
    model, theta = model.grown(theta, active("coulomb_friction", "pendulum"), [0.1, 2e-3])
    wrong = fitted(model, windows, theta)
    stuck = SearchResult(wrong, null, (), (), windows).with_best(wrong, [null, wrong])
    best = exchanged(stuck, candidates).best
    named = {str(each) for each in best.model.effects}
    assert named == {"actuator_lag (actuator)", "coulomb_friction (pendulum)"}
    assert best.chi2 < 1.2 * windows.samples.sum() < wrong.chi2


@pytest.mark.parametrize(
    ("forces", "named"), [((0.1, 0.1), "coulomb_friction"), ((0.13, 0.07), "asymmetric_friction")]
)
def test_a_special_case_is_named_where_it_explains_as_much(
    forces: tuple[float, float], named: str
) -> None:
    names = "coulomb_friction", "asymmetric_friction", "stribeck_friction"
    candidates = [active(name, "pendulum") for name in names]
    hidden = [(candidates[1], (*forces, 2e-3))]
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), hidden)
    windows = known.windows()
    model = known.model(windows)
    null = fitted(model, windows, np.zeros(model.nuisances))
    model, theta = null.model.grown(null.theta, candidates[1], [*forces, 2e-3])
    rich = fitted(model, windows, theta)
    found = SearchResult(rich, null, (), (), windows).with_best(rich, [null, rich])
    (effect,) = plainer(found, candidates).best.model.effects
    assert effect.effect.name == named


@pytest.mark.parametrize(("std", "seen"), [(2e-3, False), (5e-4, True)])
def test_where_nothing_fits_special_cases_are_tried_beside_another_effect(
    std: float, seen: bool
) -> None:
    """Coulomb friction and an encoder that is off look like friction that differs by direction."""
    candidates = [
        active("coulomb_friction", "pendulum"),
        active("asymmetric_friction", "pendulum"),
        active("sensor_offset", "angle"),
    ]
    hidden = [(candidates[0], (0.1, 2e-3)), (candidates[2], (0.02,))]
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    known = GapProblem.of(plant, recorded(plant.having(hidden), 2), 0.01, (), {"angle": std})
    windows = known.windows()
    model = known.model(windows)
    null = fitted(model, windows, np.zeros(model.nuisances))
    model, theta = null.model.grown(null.theta, candidates[1], [0.13, 0.07, 2e-3])
    rich = fitted(model, windows, theta)
    found = SearchResult(rich, null, (), (), windows).with_best(rich, [null, rich])
    models = [set(tried.model.effects) for tried in plainer(found, candidates).fits]
    assert ({candidates[0], candidates[2]} in models) == seen


def test_a_model_that_fits_to_the_noise_is_left_as_it_is(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    known, windows, null = lagging
    model, theta = null.model.grown(null.theta, active("actuator_lag", "actuator"), [0.08])
    model, theta = model.grown(theta, active("coulomb_friction", "pendulum"), [0.1, 2e-3])
    found = SearchResult(fitted(model, windows, theta), null, (), (), windows)
    found = found.with_best(found.best, [null, found.best])
    assert exchanged(found, known.candidates(windows)) is found


@pytest.mark.parametrize(("explained", "worth"), [(0.01, False), (0.2, True)])
def test_an_effect_must_explain_a_part_of_what_is_left_over(
    lagging: tuple[GapProblem, Windows, Fit], explained: float, worth: bool
) -> None:
    """However sure it is: noise beyond the reported one is larger than the effect."""
    _, windows, null = lagging
    model, theta = null.model.grown(null.theta, active("actuator_delay", "actuator"), [0.01])
    samples = 1000 * windows.samples
    many = replace(windows, y=np.repeat(windows.y, 1000, axis=2))
    smaller = replace(null, by_window=3.0 * samples, chi2=3.0 * samples.sum())
    left = (3.0 - 2.0 * explained) * samples
    larger = replace(null, model=model, theta=theta, by_window=left, chi2=left.sum())
    criterion = Criterion(many, cap=9.0, inflation=3.0, samples=samples.sum())
    assert criterion.bic(smaller) - criterion.bic(larger) > 100.0
    assert criterion.prefers(larger, smaller, smaller) == worth


@pytest.mark.parametrize(("times", "meant"), [(2.0, True), (1e6, False)])
def test_a_body_as_if_held_fast_is_no_explanation_however_well_it_fits(
    lagging: tuple[GapProblem, Windows, Fit], times: float, meant: bool
) -> None:
    _, windows, null = lagging
    armature = active("armature", "pendulum")
    value = times * null.model.scales["pendulum"].inertia
    model, theta = null.model.grown(null.theta, armature, [value])
    perfect = replace(null, model=model, theta=theta, by_window=0.0 * null.by_window, chi2=0.0)
    criterion = Criterion.of(null, windows)
    assert criterion.prefers(perfect, null, null) == meant
    found = SearchResult(null, null, (), (), windows).with_best(null, [null, perfect])
    assert [known for known, _ in found.ranked] == ([null, perfect] if meant else [null])


def friction_and_lag_are_found(known: GapProblem, windows: Windows) -> bool:
    candidates = [active("coulomb_friction", "pendulum"), active("actuator_lag", "actuator")]
    return {*search(known.model(windows), windows, candidates).best.model.effects} == {*candidates}


def test_a_search_goes_on_from_an_effect_that_is_worth_little_and_explains_most(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alone it bends the nominal parameters beyond their priors, in place of what else is there."""
    known, windows, _ = lagging
    prefers = Criterion.prefers

    def only_two(self: Criterion, larger: Fit, smaller: Fit, null: Fit) -> bool:
        return len(larger.model.effects) > 1 and prefers(self, larger, smaller, null)

    monkeypatch.setattr(Criterion, "prefers", only_two)
    assert friction_and_lag_are_found(known, windows)


def test_a_fit_that_ended_worse_than_with_an_effect_less_is_made_again(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    known, windows, null = lagging
    ended: list[Fit] = []

    def at_first_badly(fit: Fit, score: Score, windows: Windows) -> Fit:
        grown = grow(fit, score, windows)
        if len(grown.model.effects) < 2 or len(ended) > 1:
            return grown
        ended.append(replace(grown, chi2=2.0 * null.chi2, by_window=2.0 * null.by_window))
        return ended[-1]

    module = importlib.import_module("mcpilco.gap.search")
    monkeypatch.setattr(module, "grow", at_first_badly)
    assert friction_and_lag_are_found(known, windows)


def test_a_search_goes_on_where_an_effect_of_three_became_superfluous(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    friction, lag, offset = (
        active("coulomb_friction", "pendulum"),
        active("actuator_lag", "actuator"),
        active("sensor_offset", "angle"),
    )
    hidden = [(friction, (0.1, 2e-3)), (lag, (0.08,)), (offset, (0.1,))]
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), hidden)
    windows = known.windows()
    module = importlib.import_module("mcpilco.gap.search")
    leaner = module.without_superfluous
    pairs: list[Fit] = []
    dropped: list[Fit] = []

    def once_without_one(best: Fit, tried: Tried, criterion: Criterion) -> Fit:
        if len(best.model.effects) < SEARCH.most_effects or dropped:
            pairs.append(leaner(best, tried, criterion))
            return pairs[-1]
        dropped.append(tried.fits.pop(frozenset(best.model.effects)))
        return without(best, pairs[-1].model.effects[0], tried.windows, tried.null)

    monkeypatch.setattr(module, "without_superfluous", once_without_one)
    found = search(known.model(windows), windows, [friction, lag, offset])
    assert dropped
    assert {*found.best.model.effects} == {friction, lag, offset}
