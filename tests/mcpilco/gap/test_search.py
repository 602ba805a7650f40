"""How models are changed, one change at a time, and judged."""

from __future__ import annotations

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import envs
from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.disturbance import Disturbance, Evidence
from mcpilco.gap.fit import Fit, fit_initial_states, fit_nominal, misfits, on_windows
from mcpilco.gap.plant_model import ComputeBudget, PlantModel
from mcpilco.gap.screen import Score, screen
from mcpilco.gap.search import (
    Tried,
    _exchange,
    _improve,
    _next,
    _reconsider,
    confuse,
    finish,
    grow,
    resized,
    search,
    simplify,
    without,
)
from mcpilco.gap.sensitivities import linearise
from mcpilco.gap.thresholds import BUDGET, SEARCH, VERDICT
from mcpilco.plant import EffectInstance
from tests.mcpilco.gap.lagging import active, fitted, problem

FRICTION = active("coulomb_friction", "pendulum")
LAG = active("actuator_lag", "actuator")
DELAY = active("actuator_delay", "actuator")
MOTOR = active("back_emf", "pendulum")
UNEVEN = active("asymmetric_friction", "pendulum")
OFFSET = active("sensor_offset", "angle")
ARMATURE = active("armature", "pendulum")
INERTIA = active("body_inertia", "pendulum")


def found(known: GapProblem, candidates: list[EffectInstance]) -> set[EffectInstance]:
    windows = known.windows()
    return {*search(known.model(windows), windows, candidates).best.model.effects}


@pytest.mark.slow
def test_an_effect_that_stands_for_another_is_exchanged(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    """Alone a delay explains more than the lag that is there."""
    known, windows, null = lagging
    tried = Tried.begun(null, windows, [DELAY, LAG, active("actuator_dead_zone", "actuator")])
    model, theta = null.model.grown(null.theta, DELAY, [0.05])
    model, theta = model.grown(theta, FRICTION, [0.1, 2e-3])
    wrong = tried.keep(fitted(model, tried.windows, theta))
    share = known.budget.share(1.0)
    tried.neighbours(wrong, share)
    assert frozenset({LAG, FRICTION}) not in tried.fits
    tried.neighbours(wrong, share, SEARCH.part_of_exchanged)
    right = tried.fits[frozenset({LAG, FRICTION})]
    assert tried.bic(right) < tried.bic(wrong) - 15.0


def test_effects_are_exchanged_where_none_can_be_added(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    known, _, _ = lagging
    tried, neighbours = [], Tried.neighbours

    def spied(self: Tried, fit: Fit, share: ComputeBudget, part: float = 0.0) -> list[Score]:
        tried.append(({*fit.model.effects}, part > 0.0))
        return neighbours(self, fit, share, part)

    monkeypatch.setattr(Tried, "neighbours", spied)
    best = found(known, [FRICTION, LAG])
    assert best == {FRICTION, LAG}
    assert [effects for effects, exchange in tried if exchange and effects] == [best]


def test_where_a_fit_takes_masses_far_from_their_priors_effects_of_these_are_tried_too(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, windows, null = lagging
    mass = active("body_mass", "pendulum")
    candidates, asked = [FRICTION, LAG, mass], []
    tried = Tried.begun(null, windows, candidates)
    monkeypatch.setattr(tried, "add_beside", lambda fit, some, *_, **__: asked.append(some) or [])
    pulled = np.eye(len(null.theta))[0] * 5.0 * next(iter(null.model.priors.values()))
    for theta in (0.0 * pulled, pulled):
        tried.fits[frozenset()] = tried.null = replace(null, theta=theta)
        simplify(tried)
    assert asked == [[mass]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("forces", "named"), [((0.1, 0.1), FRICTION), ((0.13, 0.07), UNEVEN)], ids=["even", "uneven"]
)
def test_a_special_case_is_named_where_it_explains_as_much(
    forces: tuple[float, float], named: EffectInstance
) -> None:
    candidates = [FRICTION, UNEVEN, active("stribeck_friction", "pendulum")]
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [(UNEVEN, (*forces, 2e-3))])
    assert found(known, candidates) == {named}


def test_a_search_ends_by_the_special_cases_of_each_of_its_effects(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    """However little it has tried of them: what is there is told in its plainest form."""
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [UNEVEN, MOTOR, FRICTION, LAG, DELAY])
    model, theta = null.model.grown(null.theta, MOTOR, [0.01, 0.07])
    model, theta = model.grown(theta, UNEVEN, [0.12, 0.1, 2e-3])
    tried.keep(fitted(model, tried.windows, theta))
    simplify(tried)
    assert {*tried.best().model.effects} == {LAG, FRICTION}
    assert frozenset({DELAY, UNEVEN}) not in tried.fits


def test_a_slow_effect_is_found_though_a_random_force_does_nearly_as_much() -> None:
    """Beside that force it promises less than it must, and without it more."""
    friction, constant, spring = (
        active(name, "pendulum")
        for name in ("viscous_friction", "constant_force", "hardening_spring")
    )
    hidden = [(friction, (0.024,)), (constant, (0.09,)), (spring, (0.019,))]
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), hidden)
    null, windows = fit_nominal(known.model(known.windows()), known.windows())
    tried = Tried.begun(null, windows, [friction, constant, spring])
    model, theta = null.model.grown(null.theta, friction, [0.024])
    model, theta = model.grown(theta, constant, [0.09])
    tried.weigh_by(tried.keep(fitted(model, tried.windows, theta)))
    best = tried.best()
    bare = on_windows(best, without_forces := tried.bare(best))
    alone = screen(bare, bare.linearised(without_forces), without_forces, [spring])
    promised = tried.scores(best, [spring])[0].gain, alone[0].gain
    assert promised[0] < SEARCH.promising < promised[1]
    tried.neighbours(best, known.budget.share(1.0))
    assert {*tried.best().model.effects} == {friction, constant, spring}


def test_an_effect_is_likelier_where_no_random_force_of_a_model_without_it_stands_for_it() -> None:
    """Beside that force any size of a friction will do, and a fit ends too soon."""
    hidden = [(FRICTION, (0.5, 2e-3)), (LAG, (0.08,))]
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), hidden)
    likely = {}
    for how in (Tried.add_beside, Tried.add):
        null, windows = fit_nominal(known.model(known.windows()), known.windows())
        tried = Tried.begun(null, windows, [FRICTION])
        model, theta = null.model.grown(null.theta, LAG, [0.03])
        tried.weigh_by(tried.keep(fitted(model, tried.windows, theta)))
        alone = tried.fits[frozenset({LAG})]
        how(tried, alone, [FRICTION], 1, known.budget.share(1.0), SEARCH.promising)
        likely[how] = tried.bic(tried.fits[frozenset({LAG, FRICTION})])
    assert likely[Tried.add] < likely[Tried.add_beside] - SEARCH.bic_gain


def test_all_that_does_the_same_as_the_best_model_is_fitted() -> None:
    """A late sensor instead of a late motor, an inertia instead of a rotor's, and both."""
    armature, inertia = active("armature", "pendulum"), active("body_inertia", "pendulum")
    late = active("sensor_delay", "angle")
    hidden = [(DELAY, (0.045,)), (armature, (0.03,))]
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), hidden)
    null, windows = fit_nominal(known.model(known.windows()), known.windows())
    tried = Tried.begun(null, windows, [inertia, DELAY, late, armature])
    model, theta = null.model.grown(null.theta, DELAY, [0.045])
    model, theta = model.grown(theta, armature, [0.03])
    tried.weigh_by(tried.keep(fitted(model, tried.windows, theta)))
    confuse(tried)
    best = tried.best()
    # of equals the one that the catalogue has first
    assert {*best.model.effects} == {DELAY, inertia}
    for other in ({late, inertia}, {DELAY, armature}):
        assert tried.bic(tried.fits[frozenset(other)]) == pytest.approx(tried.bic(best), abs=0.1)


def test_what_fitted_other_windows_is_kept_where_a_fit_by_other_weights_is_less_likely(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The random forces of the model of no effect weigh these fits."""
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [LAG, FRICTION])
    model, theta = null.model.grown(null.theta, LAG, [0.08])
    model, theta = model.grown(theta, FRICTION, [0.1, 2e-3])
    right = fitted(model, windows, theta)
    astray = replace(right, theta=right.theta + np.eye(len(right.theta))[-2] * 0.05)
    monkeypatch.setattr(
        "mcpilco.gap.search.fit_model", lambda *_: on_windows(astray, tried.windows)
    )
    tried.following([right])
    assert (tried.best().theta == right.theta).all()


def test_an_effect_is_enlarged_until_more_is_missed(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    """By doubling a tenth of the friction of 0.1 N m that is there; where it is right it stays."""
    _, windows, null = lagging
    model, theta = null.model.grown(np.zeros(null.model.nuisances), LAG, [0.08])
    model, theta = model.grown(theta, FRICTION, [0.01, 2e-3])
    x0 = fit_initial_states(model, windows, theta)
    slight = Fit(model, theta, x0, misfits(model, windows, theta, x0))
    larger = resized(slight, FRICTION, windows)
    assert dict(model.effect_values(larger.theta[None]))[FRICTION][0, 0] == pytest.approx(0.08)
    assert resized(larger, FRICTION, windows) is larger


@pytest.mark.parametrize("begun", [0.01, 0.5])
def test_the_sizes_of_a_search_lead_to_the_right_one_from_either_side(
    lagging: tuple[GapProblem, Windows, Fit], begun: float
) -> None:
    _, windows, null = lagging
    model, theta = null.model.grown(np.zeros(null.model.nuisances), LAG, [0.08])
    model, theta = model.grown(theta, FRICTION, [begun, 2e-3])
    far = Fit(model, theta, null.x0, misfits(model, windows, theta, null.x0))
    found = resized(far, FRICTION, windows, SEARCH.resized, anew=True)
    assert dict(model.effect_values(found.theta[None]))[FRICTION][0, 0] == pytest.approx(
        0.1, rel=0.15
    )


def test_two_effects_are_told_as_the_one_that_they_make() -> None:
    """No single change leads there, as no joint gets two effects that say the same."""
    constant = active("constant_force", "pendulum")
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [(UNEVEN, (0.14, 0.06, 2e-3))])
    windows = known.windows()
    null, windows = fit_nominal(known.model(windows), windows)
    tried = Tried.begun(null, windows, [UNEVEN, FRICTION, constant])
    model, theta = null.model.grown(null.theta, FRICTION, [0.1, 2e-3])
    model, theta = model.grown(theta, constant, [-0.04])
    two = tried.keep(fitted(model, tried.windows, theta))
    assert tried.best() is two
    simplify(tried)
    assert {*tried.best().model.effects} == {UNEVEN}


def test_effects_are_exchanged_though_the_starts_of_a_fit_suit_others_alone() -> None:
    """Such starts hold a motion that turns over where the exchanged effects cannot."""
    constant = active("constant_force", "pendulum")
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [(UNEVEN, (0.14, 0.06, 2e-3))])
    null, windows = fit_nominal(known.model(known.windows()), known.windows())
    tried = Tried.begun(null, windows, [UNEVEN, FRICTION, constant])
    model, theta = null.model.grown(null.theta, FRICTION, [0.1, 2e-3])
    model, theta = model.grown(theta, constant, [-0.04])
    two = tried.keep(fitted(model, tried.windows, theta))
    elsewhere = replace(two, x0=two.x0 + np.array([2.5, 7.5]))
    _exchange(tried, elsewhere, [FRICTION, constant], {UNEVEN: [0.14, 0.06, 2e-3]})
    assert tried.bic(tried.fits[frozenset({UNEVEN})]) == pytest.approx(tried.bic(two), abs=10.0)


def test_starts_are_fitted_to_the_model_of_a_fit_whose_effects_came_in_another_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The numbers of one order, read in the other, make a friction of a lag."""
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [(UNEVEN, (0.14, 0.06, 2e-3))])
    null, windows = fit_nominal(known.model(known.windows()), known.windows())
    tried = Tried.begun(null, windows, [UNEVEN, FRICTION, LAG])
    model, theta = null.model.grown(null.theta, FRICTION, [0.1, 2e-3])
    model, theta = model.grown(theta, LAG, [0.01])
    kept = tried.keep(fitted(model, tried.windows, theta))
    model, theta = null.model.grown(null.theta, UNEVEN, [0.14, 0.06, 2e-3])
    model, theta = model.grown(theta, LAG, [0.01])
    best = tried.keep(fitted(model, tried.windows, theta))
    module, asked = importlib.import_module("mcpilco.gap.search"), []

    def spied(model: PlantModel, windows: Windows, theta: np.ndarray) -> np.ndarray:
        asked.append((model.effects, theta))
        return fit_initial_states(model, windows, theta)

    monkeypatch.setattr(module, "fit_initial_states", spied)
    monkeypatch.setattr(module, "fit_model", lambda *_, **__: replace(kept, theta=0.9 * kept.theta))
    _exchange(tried, best, [UNEVEN], {FRICTION: [0.1, 2e-3]})
    ((effects, numbers),) = asked
    assert effects == kept.model.effects == (FRICTION, LAG)
    np.testing.assert_array_equal(numbers, kept.theta)


def test_a_friction_and_a_lag_are_tried_as_a_motor_under_a_voltage() -> None:
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [(MOTOR, (0.05, 0.04))])
    windows, viscous = known.windows(), active("viscous_friction", "pendulum")
    null, windows = fit_nominal(known.model(windows), windows)
    tried = Tried.begun(null, windows, [viscous, LAG, MOTOR])
    model, theta = null.model.grown(null.theta, viscous, [0.05])
    model, theta = model.grown(theta, LAG, [0.04])
    tried.keep(fitted(model, tried.windows, theta))
    simplify(tried)
    assert {*tried.best().model.effects} == {MOTOR}


def test_a_motor_under_a_voltage_may_as_well_be_a_friction_and_a_lag() -> None:
    viscous = active("viscous_friction", "pendulum")
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [(viscous, (0.05,)), (LAG, (0.04,))])
    windows = known.windows()
    null, windows = fit_nominal(known.model(windows), windows)
    tried = Tried.begun(null, windows, [viscous, LAG, MOTOR, FRICTION])
    model, theta = null.model.grown(null.theta, MOTOR, [0.05, 0.04])
    tried.weigh_by(tried.keep(fitted(model, tried.windows, theta)))
    motor = tried.best()
    assert motor.model.effects == (MOTOR,)
    confuse(tried)
    both = tried.fits[frozenset({viscous, LAG})]
    assert tried.bic(both) < tried.bic(motor) + VERDICT.tied
    assert not any(FRICTION in effects for effects in tried.fits)


@pytest.mark.slow
def test_one_effect_of_masses_is_tried_in_the_place_of_several_that_imitate_it() -> None:
    """From the nominal masses: without the several a fit bends these to do the same."""
    center, inertia, mass = (
        active(name, body)
        for name, body in (
            ("center_of_mass", "lower"),
            ("body_inertia", "upper"),
            ("body_mass", "lower"),
        )
    )
    plant = envs.PLANTS["mcpilco/DoublePendulum-v0"]()
    known = problem(plant, [(center, (-0.05,))])
    null, windows = fit_nominal(known.model(known.windows()), known.windows())
    tried = Tried.begun(null, windows, [center, inertia, mass])
    model, theta = null.model.grown(null.theta, inertia, [0.002])
    model, theta = model.grown(theta, mass, [-0.05])
    tried.keep(fitted(model, tried.windows, theta))
    assert {*tried.best().model.effects} == {inertia, mass}
    simplify(tried)
    assert {*tried.best().model.effects} == {center}


def test_what_plainer_forms_lead_to_is_weighed_by_its_own_random_forces(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By those of a model that misses an effect, what is slight promises nothing."""
    known, windows, null = lagging
    tried = Tried.begun(null, windows, [])
    model, theta = null.model.grown(null.theta, LAG, [0.05])
    plainer = [fitted(model, tried.windows, theta)]
    module, weigh = importlib.import_module("mcpilco.gap.search"), Tried.weigh_by
    weighed: list[set[EffectInstance]] = []

    def spied(self: Tried, best: Fit) -> None:
        weighed.append({*best.model.effects})
        weigh(self, best)

    monkeypatch.setattr(module, "simplify", lambda its: plainer and its.keep(plainer.pop()))
    monkeypatch.setattr(Tried, "weigh_by", spied)
    _improve(tried, known.budget.share(1.0))
    assert weighed == [{LAG}]


def test_where_the_likeliest_model_explains_too_little_another_may_be_due_to_the_priors(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [])
    pulled = np.eye(len(null.theta))[0] * 5.0 * next(iter(null.model.priors.values()))
    null = tried.null = replace(null, theta=pulled)
    grown = [null.model.grown(pulled, DELAY, [0.01]), null.model.grown(0.0 * pulled, LAG, [0.01])]
    likeliest, meant = (replace(null, model=model, theta=theta) for model, theta in grown)
    for fit, std, deviance in ((null, 0.05, 3e3), (likeliest, 0.04, 2.9e3), (meant, 0.05, 3e3)):
        key = frozenset(fit.model.effects)
        tried.fits[key] = fit
        tried.evidence[key] = Evidence(
            deviance, np.array([std]), np.array([1.0]), 1000, np.zeros(1)
        )
    assert tried.ranked[0] is likeliest
    assert tried.best() is meant


def test_what_promised_too_little_by_the_weights_of_another_model_is_tried_by_its_own(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where much is left over by another model, an effect takes away less of it."""
    known, windows, null = lagging
    tried, share = Tried.begun(null, windows, [LAG]), known.budget.share(1.0)
    module = importlib.import_module("mcpilco.gap.search")
    monkeypatch.setattr(module, "screen", lambda *_, **how: [])
    tried.neighbours(tried.null, share)
    monkeypatch.undo()
    tried.neighbours(tried.null, share)
    assert frozenset({LAG}) not in tried.fits  # nothing is asked twice by the same weights
    tried.weigh_by(tried.null)
    tried.neighbours(tried.null, share)
    assert frozenset({LAG}) in tried.fits


def test_scores_are_known_as_long_as_the_same_weights_count(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, windows, null = lagging
    tried, asked = Tried.begun(null, windows, [LAG, FRICTION]), []
    module = importlib.import_module("mcpilco.gap.search")

    def counted(*given: Any, **how: Any) -> list[Score]:
        asked.append(given[3])
        return screen(*given, **how)

    monkeypatch.setattr(module, "screen", counted)
    both = tried.scores(tried.null, [LAG, FRICTION])
    assert {score.instance for score in both} == {LAG, FRICTION}
    some = tried.scores(tried.null, [FRICTION])
    assert some == [score for score in both if score.instance == FRICTION]
    assert asked == [[LAG, FRICTION]]
    other = replace(tried.null, theta=0.5 * tried.null.theta)
    assert tried.scores(other, [LAG])[0].gain != next(s for s in both if s.instance == LAG).gain
    tried.weigh_by(tried.null)
    tried.scores(tried.null, [LAG, FRICTION])
    assert asked == [[LAG, FRICTION], [LAG], [LAG, FRICTION]]


@pytest.mark.parametrize("stds", [1.0, 5.0])
def test_the_likeliest_model_that_keeps_to_its_priors_goes_on_beside_one_that_does_not(
    lagging: tuple[GapProblem, Windows, Fit], stds: float
) -> None:
    """Masses far from what is known may stand for several effects, of which each alone is worse."""
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [])
    pulled = np.eye(len(null.theta))[0] * stds * next(iter(null.model.priors.values()))
    best = tried.null = replace(null, theta=pulled)
    model, theta = null.model.grown(0.0 * pulled, DELAY, [0.01])
    eased = replace(null, model=model, theta=theta)
    for fit, deviance in ((best, 1e3), (eased, 1.2e3)):
        key = frozenset(fit.model.effects)
        tried.fits[key] = fit
        tried.evidence[key] = Evidence(deviance, np.zeros(1), np.ones(2), 1000, np.zeros(2))
    tried.grown.add((frozenset(), True))
    assert tried.best() is best
    assert _next(tried, best) == ([eased] if stds == 5.0 else [])
    tried.grown.add((frozenset({DELAY}), False))
    assert _next(tried, best) == []


def test_no_joint_gets_two_effects_where_one_says_the_same() -> None:
    """Friction that differs by direction is Coulomb's and a constant force."""
    constant = active("constant_force", "pendulum")
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [(UNEVEN, (0.14, 0.06, 2e-3))])
    windows = known.windows()
    result = search(known.model(windows), windows, [UNEVEN, FRICTION, constant])
    sets = [set(fit.model.effects) for fit in result.fits]
    assert {UNEVEN} in sets
    assert not any(UNEVEN in each and len(each) > 1 for each in sets)


@pytest.mark.parametrize(
    ("before", "after", "worth"),
    [
        ((0.05, 1.0), (0.04, 1.0), False),  # a random force, and a noise
        ((0.05, 1.0), (0.03, 1.0), True),
        ((0.05, 2.0), (0.05, 1.1), True),
        ((0.009, 1.0), (0.009, 1.0), True),
        ((0.009, 2.1), (0.009, 2.1), True),
        ((0.009, 3.1), (0.009, 3.1), False),
    ],
    ids=["explains less", "explains more", "in a reading", "nothing is left", "noise", "too much"],
)
def test_an_effect_explains_as_much_as_it_leaves(
    lagging: tuple[GapProblem, Windows, Fit],
    before: tuple[float, float],
    after: tuple[float, float],
    worth: bool,
) -> None:
    """However likely it is: what is left of a machine's forces has a form of its own."""
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [])
    model, theta = null.model.grown(null.theta, DELAY, [0.01])
    larger = replace(null, model=model, theta=theta)
    for fit, (std, noise), deviance in ((null, before, 3e3), (larger, after, 1e3)):
        key = frozenset(fit.model.effects)
        tried.fits[key] = fit
        tried.evidence[key] = Evidence(
            deviance, np.array([std]), np.array([noise]), 1000, np.zeros(1)
        )
    assert tried.bic(null) - tried.bic(larger) > 1000.0
    assert tried.prefers(larger, null) == worth
    assert (tried.best() is larger) == worth


@pytest.mark.parametrize(("stds", "meant"), [(5.0, True), (1.0, False)])
def test_an_effect_is_worth_it_that_brings_a_parameter_back_to_its_prior(
    lagging: tuple[GapProblem, Windows, Fit], stds: float, meant: bool
) -> None:
    """However much is left over: no imitation is at work where the prior alone speaks."""
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [])
    pulled = np.eye(len(null.theta))[0] * stds * next(iter(null.model.priors.values()))
    smaller = replace(null, theta=pulled)
    model, theta = null.model.grown(np.zeros_like(pulled), DELAY, [0.01])
    larger = replace(null, model=model, theta=theta)
    for fit in (smaller, larger):
        key = frozenset(fit.model.effects)
        tried.fits[key] = fit
        tried.evidence[key] = Evidence(1e3, np.array([0.05]), np.ones(2), 1000, np.zeros(2))
    assert tried.prefers(larger, smaller) == meant


@pytest.mark.parametrize(("times", "meant"), [(2.0, True), (1e6, False)])
def test_a_body_as_if_held_fast_is_no_explanation_however_well_it_fits(
    lagging: tuple[GapProblem, Windows, Fit], times: float, meant: bool
) -> None:
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [])
    value = times * null.model.scales["pendulum"].inertia
    model, theta = null.model.grown(null.theta, active("armature", "pendulum"), [value])
    perfect = replace(null, model=model, theta=theta)
    key = frozenset(model.effects)
    tried.fits[key] = perfect
    tried.evidence[key] = Evidence(-1e6, np.zeros(1), np.ones(2), 1000, np.zeros(2))
    assert tried.prefers(perfect, tried.null) == meant


@pytest.mark.slow
def test_two_effects_are_found_of_which_each_alone_is_imitated(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    known, windows, _ = lagging
    result = search(known.model(windows), windows, known.candidates(windows))
    assert {*result.best.model.effects} == {FRICTION, LAG}
    assert result.ranked[0][0] is result.best
    assert all(bic >= result.ranked[0][1] for _, bic in result.ranked[1:])


@pytest.mark.slow
def test_three_effects_are_found_of_which_none_explains_as_much_as_the_others() -> None:
    uneven, ripple = (0.16, 0.06, 2e-3), (0.17, 0.04, 3.9)
    hidden = [(UNEVEN, uneven), (LAG, (0.04,)), (active("position_ripple", "pendulum"), ripple)]
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), hidden)
    assert found(known, known.candidates(known.windows())) == {each for each, _ in hidden}


@pytest.mark.slow
def test_three_effects_are_found() -> None:
    """A turned encoder and a tilted machine are one thing where gravity alone depends on angles."""
    hidden = [(FRICTION, (0.1, 2e-3)), (LAG, (0.08,)), (OFFSET, (0.1,))]
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), hidden)
    tilt = active("gravity_tilt", "pendulum")
    told = found(known, known.candidates(known.windows()))
    assert told in ({FRICTION, LAG, OFFSET}, {FRICTION, LAG, tilt})


def test_where_nothing_is_hidden_nothing_is_found() -> None:
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [])
    assert found(known, known.candidates(known.windows())) == set()


def test_a_model_without_a_parameter_s_effect_has_its_prior_back(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    _, windows, null = lagging
    gain = active("actuator_gain", "actuator")
    number = null.model.frees(gain)
    assert number is not None
    freed = replace(null, model=null.model.having(gain))
    back = without(freed, [gain], windows, null)
    assert list(back.model.priors.items()) == list(null.model.priors.items())
    assert not back.model.effects


def test_the_better_of_two_fits_of_the_same_effects_is_kept(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [])
    model, theta = null.model.grown(null.theta, LAG, [0.08])
    good = tried.keep(fitted(model, tried.windows, theta))
    bad = replace(good, theta=theta + 0.5)
    assert tried.keep(bad) is good
    assert tried.fits[frozenset({LAG})] is good


def test_a_search_whose_budget_is_used_up_has_what_was_found_before(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    known, windows, null = lagging
    model, theta = null.model.grown(null.theta, LAG, [0.08])
    before = fitted(model, windows, theta)
    spent = replace(
        known.model(windows), budget=ComputeBudget(most=1.0, used=np.ones(1, dtype=int))
    )
    assert not search(spent, windows, [LAG]).best.model.effects
    assert {*search(spent, windows, [LAG], (before,)).best.model.effects} == {LAG}


def test_an_effect_that_the_others_made_needless_is_dropped(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    """Even where the steps of the search are used up: none of its neighbours is tried."""
    known, windows, null = lagging
    model, theta = null.model, null.theta
    for effect, values in ((OFFSET, [0.01]), (LAG, [0.08]), (FRICTION, [0.1, 2e-3])):
        model, theta = model.grown(theta, effect, values)
    before = fitted(model, windows, theta)
    spent = replace(
        known.model(windows), budget=ComputeBudget(most=1.0, used=np.ones(1, dtype=int))
    )
    result = search(spent, windows, [LAG, FRICTION, OFFSET], (before,))
    assert {*result.best.model.effects} == {LAG, FRICTION}


def test_what_does_the_same_to_every_motion_is_as_likely_as_what_was_found() -> None:
    """No recording of a pendulum tells the inertia of its motor from that of its rod."""
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    hidden = (ARMATURE, [0.1]), (FRICTION, [0.1, 2e-3])
    known = problem(plant, hidden)
    windows = known.windows()
    null = fitted(known.model(windows), windows, np.zeros(known.model(windows).nuisances))
    model, theta = null.model, null.theta
    for effect, values in hidden:
        model, theta = model.grown(theta, effect, values)
    tried = Tried.begun(null, windows, [ARMATURE, INERTIA, FRICTION, LAG])
    tried.weigh_by(tried.keep(fitted(model, tried.windows, theta)))
    right = tried.keep(fitted(model, tried.windows, theta))  # by its own random forces
    other = frozenset({INERTIA, FRICTION})
    assert tried.best() is right
    assert other not in tried.fits
    confuse(tried)
    assert abs(tried.bic(tried.fits[other]) - tried.bic(right)) < VERDICT.tied
    assert frozenset({ARMATURE, LAG}) not in tried.fits


def test_what_does_the_same_is_found_where_the_steps_of_a_search_are_used_up() -> None:
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [(ARMATURE, [0.1])])
    windows = known.windows()
    null = fitted(known.model(windows), windows, np.zeros(known.model(windows).nuisances))
    tried = Tried.begun(null, windows, [ARMATURE, INERTIA, LAG])
    model, theta = null.model.grown(null.theta, ARMATURE, [0.1])
    tried.keep(fitted(model, tried.windows, theta))
    budget = model.budget
    budget.used[0] = budget.most
    confuse(tried)
    assert frozenset({INERTIA}) in tried.fits
    assert budget.used[0] < budget.most + BUDGET.stage_steps


def test_a_gain_and_a_mass_are_as_likely_where_friction_may_be_anything() -> None:
    """A pendulum that is heavier all over moves as one whose motor and friction are weaker."""
    gain, mass = active("actuator_gain", "actuator"), active("body_mass", "pendulum")
    hidden = (gain, [0.8]), (active("viscous_friction", "pendulum"), [0.03])
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), hidden)
    windows = known.windows()
    null = fitted(known.model(windows), windows, np.zeros(known.model(windows).nuisances))
    model, theta = null.model, null.theta
    for effect, values in hidden:
        model, theta = model.grown(theta, effect, values)
    tried = Tried.begun(null, windows, [effect for effect, _ in hidden] + [mass, LAG])
    right = tried.keep(fitted(model, tried.windows, theta))
    other = frozenset({mass, hidden[1][0]})
    assert tried.best() is right
    confuse(tried)
    assert abs(tried.bic(tried.fits[other]) - tried.bic(right)) < VERDICT.tied
    assert not any(LAG in effects for effects in tried.fits)


@pytest.mark.slow
def test_an_effect_that_came_first_is_exchanged_for_one_that_promises_as_much_in_its_place(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    known, windows, null = lagging
    tried = Tried.begun(null, windows, [DELAY, LAG, FRICTION, OFFSET])
    model, theta = null.model.grown(null.theta, DELAY, [0.05])
    model, theta = model.grown(theta, FRICTION, [0.1, 2e-3])
    wrong = tried.keep(fitted(model, tried.windows, theta))
    tried.weigh_by(wrong)
    assert {*tried.best().model.effects} == {DELAY, FRICTION}
    _reconsider(tried, known.budget.share(1.0))
    assert {*tried.best().model.effects} == {LAG, FRICTION}


@pytest.mark.parametrize("most", [1.0, 1e9])
def test_effects_are_exchanged_at_last_where_the_steps_of_a_search_are_used_up(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch, most: float
) -> None:
    known, windows, _ = lagging
    budget, seen = ComputeBudget(most=most, used=np.ones(1, dtype=int)), []
    module = importlib.import_module("mcpilco.gap.search")
    monkeypatch.setattr(module, "_reconsider", lambda tried, share: seen.append(tried.best()))
    search(replace(known.model(windows), budget=budget), windows, [LAG])
    assert bool(seen) == (most == 1.0)


def test_a_model_is_judged_along_its_own_motions_whichever_is_the_best(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """But where a simulation is dear: there it is along those of the best one."""
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [FRICTION])
    model, theta = null.model.grown(null.theta, FRICTION, [0.1, 2e-3])
    rubbing = tried.keep(fitted(model, tried.windows, theta))
    own = Disturbance.of(rubbing, windows).evidence(rubbing).deviance
    tried.weigh_by(tried.null)
    assert tried.judged(rubbing).deviance == pytest.approx(own)
    monkeypatch.setattr(type(model.plant), "costly", True)
    tried.weigh_by(tried.null)
    along_another = tried.disturbance.evidence(rubbing).deviance
    assert abs(own - along_another) > 1e-3
    assert tried.judged(rubbing).deviance == pytest.approx(along_another)


def test_fits_that_are_followed_are_weighed_as_those_that_come_after_them(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [LAG, FRICTION])
    model, theta = null.model.grown(null.theta, LAG, [0.08])
    tried.weigh_by(tried.keep(fitted(model, tried.windows, theta)))
    assert len(tried.fits) == 2
    for fit in tried.fits.values():
        now = misfits(fit.model, tried.windows, fit.theta, fit.x0)
        np.testing.assert_array_equal(fit.by_window, now)
        assert fit.chi2 == pytest.approx(now.sum() + fit.model.penalty(fit.theta))


def test_where_a_simulation_is_dear_what_misses_no_less_at_any_size_is_not_fitted(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    known, windows, null = lagging
    lag = Score(LAG, 100.0, np.array([0.04]), 1.0)
    spring = Score(active("spring", "pendulum"), 100.0, np.array([1.0]), 1.0)
    model, theta = null.model.grown(null.theta, LAG, [0.08])
    model, theta = model.grown(theta, FRICTION, [0.1, 2e-3])
    right = fitted(model, windows, theta)
    for costly in (False, True):
        monkeypatch.setattr(type(known.plant), "costly", costly)
        lin = linearise(null.model, windows, null.theta, null.x0)
        assert grow(null, lag, windows, lin) is not None
        lin = linearise(right.model, windows, right.theta, right.x0)
        assert (grow(right, spring, windows, lin) is None) == costly


def test_where_a_simulation_is_dear_effects_of_masses_are_tried_last(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All others are, as it is, and a wrong model takes its masses anywhere."""
    known, windows, null = lagging
    calls: list[str] = []
    monkeypatch.setattr("mcpilco.gap.search.relieve", lambda *_: calls.append("masses"))
    monkeypatch.setattr(Tried, "neighbours", lambda *_: calls.append("all") or [])
    for costly in (False, True):
        monkeypatch.setattr(type(known.plant), "costly", costly)
        calls.clear()
        _improve(Tried.begun(null, windows, [LAG]), known.budget.share(1.0))
        assert calls[0] == ("all" if costly else "masses")
        assert calls.count("masses") == 1


def test_where_a_simulation_is_dear_no_model_goes_on_beside_one_that_leaves_nothing(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    known, windows, null = lagging
    tried = Tried.begun(null, windows, [LAG, FRICTION])
    model, theta = null.model.grown(null.theta, LAG, [0.04])
    model, theta = model.grown(theta, FRICTION, [0.1, 2e-3])
    best = tried.keep(fitted(model, tried.windows, theta))
    tried.weigh_by(best)
    best = tried.best()
    tried.keep(without(best, [LAG], tried.windows, null))
    tried.keep(without(best, [FRICTION], tried.windows, null))
    assert tried.best() is best
    none = replace(tried.judged(best), std=np.zeros(1), noise=np.ones(2))
    tried.evidence[frozenset({LAG, FRICTION})] = none
    for fit in tried.fits.values():  # far likelier than the best, were they but preferred
        if fit is not best:
            far = replace(tried.judged(fit), deviance=none.deviance - 100.0)
            tried.evidence[frozenset(fit.model.effects)] = far
    assert len(_next(tried, best)) > 1
    monkeypatch.setattr(type(known.plant), "costly", True)
    assert _next(tried, best) == [best]


def test_where_a_simulation_is_dear_only_what_promises_much_is_fitted(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    known, windows, null = lagging
    heavier, fits = active("armature", "pendulum"), []
    for costly in (False, True):
        monkeypatch.setattr(type(known.plant), "costly", costly)
        tried = Tried.begun(null, windows, [LAG, DELAY, FRICTION, heavier])
        tried.neighbours(tried.null, known.budget.share(1.0))
        fits.append({*tried.fits} - {frozenset()})
    much = {frozenset({LAG}), frozenset({DELAY})}
    assert fits == [much | {frozenset({heavier}), frozenset({FRICTION})}, much]


def test_where_a_simulation_is_dear_initial_states_of_all_windows_give_way_to_an_effect(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of the model without it may have been led astray in any window."""
    known, windows, null = lagging
    module, asked = importlib.import_module("mcpilco.gap.search"), []
    told = module.improved_initial_states

    def giving(model: PlantModel, some: Windows, theta: np.ndarray, *begun: Any) -> np.ndarray:
        moved = told(model, some, theta, *begun)
        if len(moved) == len(windows):  # not of the part to which it was fitted first
            missed, before = (misfits(model, some, theta, x0) for x0 in (moved, begun[0]))
            assert (missed <= before).all()
            asked.append(model.effects)
        return moved

    monkeypatch.setattr(module, "improved_initial_states", giving)
    monkeypatch.setattr(type(known.plant), "costly", True)
    tried = Tried.begun(null, windows, [LAG])
    tried.neighbours(tried.null, known.budget.share(1.0))
    assert asked == [(LAG,)]


def test_what_explains_half_as_much_as_the_best_model_is_fitted_to_its_end(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    """Where a simulation is dear fits end soon: of a lag and a delay the one that got further."""
    _, windows, null = lagging
    tried = Tried.begun(null, windows, [DELAY, LAG, OFFSET])
    ends, cut = {}, {}
    for effect, value, part in ((DELAY, 0.06, 1.0), (LAG, 0.06, 0.4), (OFFSET, 0.01, 0.5)):
        model, theta = null.model.grown(null.theta, effect, [value])
        ends[effect] = end = fitted(model, tried.windows, theta)
        model, theta = null.model.grown(null.theta, effect, [part * end.theta[-1]])
        soon = on_windows(replace(end, model=model, theta=theta), tried.windows)
        cut[effect] = tried.keep(soon)
    assert {*tried.best().model.effects} == {DELAY}
    assert cut[LAG].chi2 > ends[LAG].chi2 + 10.0
    finish(tried)
    assert tried.fits[frozenset({LAG})].chi2 < ends[LAG].chi2 + 1.0
    assert tried.fits[frozenset({OFFSET})] is cut[OFFSET]


def test_where_a_simulation_is_dear_motions_near_what_was_measured_are_sought_once(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Other weights change how likely they are, and not where they are."""
    known, windows, null = lagging
    module, asked = importlib.import_module("mcpilco.gap.search"), []
    told = module.nearer
    monkeypatch.setattr(module, "nearer", lambda fit, some: asked.append(fit) or told(fit, some))
    monkeypatch.setattr(type(known.plant), "costly", True)
    tried = Tried.begun(null, windows, [LAG])
    tried.neighbours(tried.null, known.budget.share(1.0))
    often = len(asked)
    tried.weigh_by(tried.best())
    assert {*tried.best().model.effects} == {LAG}
    assert len(asked) == often > 1
    for fit in tried.ranked:
        own = tried.disturbance.evidence(fit)
        assert tried.judged(fit).deviance == pytest.approx(own.deviance, rel=1e-3)
