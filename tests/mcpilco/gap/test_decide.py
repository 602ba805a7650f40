"""The forces that a model leaves over, and which effects are sure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import envs
from mcpilco.gap import decide
from mcpilco.gap.comparison import Interval
from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.decide import (
    EstimatedParameter,
    Weighed,
    leaves_something,
    left_forces,
    named_effects,
    on_bounds,
    rivals,
    shifted_parameters,
    slight_effects,
    spread_of,
    uncertain_effects,
    weighed,
)
from mcpilco.gap.disturbance import Disturbance, Evidence
from mcpilco.gap.fit import Fit, fit_initial_states, fit_model, fit_nominal
from mcpilco.gap.plant_model import GridForce, PlantModel
from mcpilco.gap.posterior import Posterior, lasting
from mcpilco.gap.search import SearchResult
from mcpilco.gap.sensitivities import run
from mcpilco.gap.thresholds import SEARCH, VERDICT
from mcpilco.plant import CATALOGUE, Axis, EffectInstance
from tests.mcpilco.gap.pendulum import Force, Outside, dry_friction, record

FRICTION = EffectInstance(CATALOGUE["coulomb_friction"], "pendulum")
SPRING = EffectInstance(CATALOGUE["spring"], "pendulum")
INERTIA = EffectInstance(CATALOGUE["body_inertia"], "pendulum")
OFFSET = EffectInstance(CATALOGUE["sensor_offset"], "angle")
GAIN = EffectInstance(CATALOGUE["actuator_gain"], "actuator")
NOTHING = Evidence(0.0, np.zeros(1), np.ones(2), 1000, np.zeros(2))
SIZES = {FRICTION: (0.1, 2e-3), SPRING: (0.02,), INERTIA: (0.02,), OFFSET: (0.01,), GAIN: (0.7,)}


@pytest.fixture(scope="module")
def rubbing() -> tuple[PlantModel, Windows]:
    """Windows of a pendulum with Coulomb friction, and the model without effects."""
    rng = np.random.default_rng(0)
    recordings = [record(rng, dry_friction(0.1), number) for number in range(2)]
    known = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    windows = known.windows()
    return known.model(windows), windows


def with_effects(nominal: PlantModel, windows: Windows, effects: list[EffectInstance]) -> Fit:
    model, theta = nominal, np.zeros(nominal.nuisances)
    for active in effects:
        model, theta = model.grown(theta, active, SIZES[active])
    return fit_model(model, windows, theta, fit_initial_states(model, windows, theta))


def searched(
    nominal: PlantModel, windows: Windows, effects: list[EffectInstance]
) -> tuple[SearchResult, Fit]:
    """A search that ended with these effects, and their fit."""
    null, best = (with_effects(nominal, windows, each) for each in ([], effects))
    return SearchResult(best, null, ((best, 0.0), (null, 500.0)), (), windows, NOTHING), best


def judging(nominal: PlantModel, windows: Windows, effects: list[EffectInstance]) -> Weighed:
    """These effects and none, as they are."""
    null, best = (with_effects(nominal, windows, each) for each in ([], effects))
    return Weighed(best, null, windows, NOTHING, NOTHING)


def test_a_window_that_runs_away_makes_no_effect_slight(
    rubbing: tuple[PlantModel, Windows], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Near an unstable rest a hundredth of a mass leads a motion anywhere."""
    nominal, windows = rubbing
    null, best = (with_effects(nominal, windows, each) for each in ([], [FRICTION]))
    fitted = run(best.model, windows, best.theta[None], best.x0[None])

    def far(model: PlantModel, some: Windows, theta: np.ndarray, x0: np.ndarray) -> np.ndarray:
        y = run(model, some, theta, x0)
        if len(model.effects):  # the mass is changed
            y[0, 0] += 100.0 * (y[0, 0] - fitted[0, 0])
        return y

    monkeypatch.setattr("mcpilco.gap.decide.run", far)
    assert slight_effects(best, null, windows) == []


def test_errors_of_parameters_count_by_what_they_do_and_not_by_their_slopes(
    rubbing: tuple[PlantModel, Windows],
) -> None:
    """Behind an impact a slope is tens of times as steep as what an error of 1 % does."""
    nominal, windows = rubbing
    null, best = (with_effects(nominal, windows, each) for each in ([], [FRICTION]))
    best.linearised(windows).Jp[:] *= 1e4
    assert slight_effects(best, null, windows) == []


@pytest.fixture
def slight(
    rubbing: tuple[PlantModel, Windows],
) -> Callable[[EffectInstance, float, float], list[EffectInstance]]:
    """Finds which of a friction and an effect of some size is slight beside errors of some std."""
    nominal, windows = rubbing
    null = with_effects(nominal, windows, [])
    fits = {each: with_effects(nominal, windows, [FRICTION, each]) for each in (SPRING, INERTIA)}

    def found(instance: EffectInstance, size: float, std: float) -> list[EffectInstance]:
        best = fits[instance]
        theta, place = best.theta.copy(), best.model.spans()[1]
        theta[place] = 1.0
        theta[place] = size / best.model.effect_values(theta[None])[1][1].item()
        told = replace(null, model=replace(nominal, priors=dict.fromkeys(nominal.priors, std)))
        return slight_effects(replace(best, theta=theta), told, windows)

    return found


def test_what_moves_less_than_told_errors_of_parameters_is_slight(slight: Callable) -> None:
    """A spring of 1e-5 N m/rad beside a mass that may be 1 % wrong, and beside an exact one."""
    assert slight(SPRING, 1e-5, 0.01) == [SPRING]
    assert slight(SPRING, 0.05, 0.01) == []
    assert slight(SPRING, 1e-5, 0.0) == slight(SPRING, 1e-5, np.inf) == []


@pytest.mark.parametrize(("instance", "times"), [(SPRING, 1.0), (INERTIA, 3.0)])
def test_an_effect_of_a_body_is_told_beyond_what_is_told_to_be_uncertain_of_bodies(
    slight: Callable, instance: EffectInstance, times: float
) -> None:
    """Beside masses that may be 3 % wrong an inertia is no finding which is one beside 1 %."""
    sizes = np.geomspace(1e-5, 0.1, 120)
    one, three = (
        next(size for size in sizes if slight(instance, size, std) == []) for std in (0.01, 0.03)
    )
    assert three / one == pytest.approx(times, rel=0.1)


def test_a_fit_by_its_own_weights_counts_only_where_it_is_likelier(
    rubbing: tuple[PlantModel, Windows], monkeypatch: pytest.MonkeyPatch
) -> None:
    result, best = searched(*rubbing, [FRICTION])

    def wandering(*given: Any, **how: Any) -> Fit:
        fit = fit_model(*given, **how)
        return replace(fit, theta=1.5 * fit.theta)

    monkeypatch.setattr(decide, "fit_model", wandering)
    judged = weighed(result, best, result.null, rubbing[1])
    np.testing.assert_array_equal(judged.best.theta, best.theta)


@pytest.mark.parametrize(("part", "uncertain"), [(0.0, []), (0.3, []), (2.0, [FRICTION])])
def test_what_lasting_forces_may_do_as_well_is_uncertain(
    rubbing: tuple[PlantModel, Windows], part: float, uncertain: list[EffectInstance]
) -> None:
    """A friction beside a force that is as large, and may be alike in all windows."""
    nominal, windows = rubbing
    fit = with_effects(nominal, windows, [FRICTION])
    std = np.array([part * 0.1 / fit.model.scales["pendulum"].force])
    lasts = lasting(Disturbance.of(fit, windows), fit, windows, std)
    assert uncertain_effects(Posterior(fit, windows, lasts)) == uncertain


@pytest.mark.parametrize("why", ["slight_effects", "uncertain_effects"])
def test_what_is_not_told_is_nothing_that_is_left(
    rubbing: tuple[PlantModel, Windows], why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is too slight, or may be none, and not worth a word; but it helps."""
    nominal, windows = rubbing
    result, best = searched(nominal, windows, [FRICTION])
    every = {
        "slight_effects": lambda fit, *_: list(fit.model.effects),
        "uncertain_effects": lambda posterior: list(posterior.fit.model.effects),
    }
    monkeypatch.setattr(decide, why, every[why])
    judged = weighed(result, best, result.null, windows)
    assert judged.best.model.effects == ()
    assert leaves_something(replace(judged, whole=None))
    assert not leaves_something(judged)


@pytest.mark.parametrize(
    ("std", "noise", "left"),
    [(0.0, 1.0, False), (0.01, 1.5, False), (0.05, 1.0, True), (0.0, 5.0, True)],
)
def test_a_force_is_left_beyond_what_small_errors_of_masses_make(
    std: float, noise: float, left: bool
) -> None:
    assert (
        Evidence(0.0, np.array([0.0, std]), np.array([1.0, noise]), 100, np.zeros(2)).deficient
        == left
    )


def detent(q: float, v: float) -> float:
    """A torque that pulls towards 0.4 rad, within some 0.1 rad of it."""
    return -1.5 * (q - 0.4) * float(np.exp(-(((q - 0.4) / 0.1) ** 2)))


def gusts(time: float) -> float:
    """A torque that no state tells."""
    return 0.025 * float(np.random.default_rng(int(time / 0.06)).standard_normal())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("force", "outside", "left"),
    [(detent, lambda _: 0.0, True), (lambda q, v: 0.0, gusts, False)],
    ids=["detent", "gusts"],
)
def test_a_small_force_is_left_where_state_and_command_predict_it(
    force: Force, outside: Outside, left: bool
) -> None:
    rng = np.random.default_rng(8)
    recordings = [record(rng, force, number, outside=outside) for number in range(3)]
    known = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    fit, windows = fit_nominal(known.model(known.windows()), known.windows())
    evidence = Disturbance.of(fit, windows).evidence(fit)
    assert SEARCH.least_force < evidence.std[0] < VERDICT.force
    judged = Weighed(fit, fit, windows, evidence, evidence)
    assert leaves_something(judged) == left


@pytest.mark.parametrize(
    ("closed", "held_out", "fitted", "bad"),
    [
        (0.9, 50.0, 1.0, False),
        (0.3, 1.2, 1.0, False),
        (0.3, 4.0, 1.0, True),
        (0.3, 4.0, 3.0, False),
    ],
)
def test_effects_that_leave_the_held_out_error_are_not_what_is_missing(
    rubbing: tuple[PlantModel, Windows],
    monkeypatch: pytest.MonkeyPatch,
    closed: float,
    held_out: float,
    fitted: float,
    bad: bool,
) -> None:
    nominal, windows = rubbing
    judged = judging(nominal, windows, [FRICTION])
    clear = windows[:5]
    beyond = {len(windows): fitted, len(clear): held_out}
    monkeypatch.setattr(decide, "error_reduction", lambda *_: Interval(closed, 0.0, 1.0))
    monkeypatch.setattr(decide, "misfit_over_expected", lambda fit, some, _: beyond[len(some)])
    assert decide.mispredicts(judged, clear) == bad
    assert not decide.mispredicts(judging(nominal, windows, []), clear)


def test_effects_that_are_too_slight_to_be_told_help_where_held_out_windows_are_judged(
    rubbing: tuple[PlantModel, Windows], monkeypatch: pytest.MonkeyPatch
) -> None:
    nominal, windows = rubbing
    clear, whole = windows[:5], judging(nominal, windows, [FRICTION, SPRING])
    told = judging(nominal, windows, [FRICTION])

    def misfit(fit: Fit, some: Windows, _: Evidence) -> float:
        return 4.0 if some is clear and fit is told.best else 1.0

    monkeypatch.setattr(decide, "error_reduction", lambda *_: Interval(0.3, 0.0, 1.0))
    monkeypatch.setattr(decide, "misfit_over_expected", misfit)
    assert decide.mispredicts(told, clear)
    assert not decide.mispredicts(replace(told, whole=whole), clear)


@pytest.mark.parametrize(
    ("closed", "low", "most"),
    [
        (0.9, 0.7, True),
        (0.6, 0.55, True),
        (0.9, 0.45, False),
        (0.3, 0.2, False),
        (0.9, -0.1, False),
    ],
)
def test_beside_what_is_unknown_effects_are_named_that_surely_close_most_of_the_gap(
    rubbing: tuple[PlantModel, Windows],
    monkeypatch: pytest.MonkeyPatch,
    closed: float,
    low: float,
    most: bool,
) -> None:
    judged = judging(*rubbing, [])
    monkeypatch.setattr(decide, "error_reduction", lambda *_: Interval(closed, low, 1.0))
    assert decide.closes_most(judged, rubbing[1]) == most


@pytest.mark.parametrize(
    "none", [[SPRING], [OFFSET], [SPRING, OFFSET]], ids=["spring", "offset", "both"]
)
def test_effects_that_may_be_none_are_not_named(
    rubbing: tuple[PlantModel, Windows], none: list[EffectInstance]
) -> None:
    nominal, windows = rubbing
    result, best = searched(nominal, windows, [FRICTION, *none])
    judged = weighed(result, best, result.null, windows)
    assert judged.best.model.effects == (FRICTION,)
    (named,) = named_effects(result, judged)
    assert named.parameters["f_c"].low < 0.1 < named.parameters["f_c"].high
    assert named.share > 0.95


def test_an_effect_closes_the_gap_though_a_refit_by_absurd_parameters_would_do_so_too() -> None:
    """A weak motor moves a pendulum as a strong one moves one that is heavier and rubs more."""
    rng = np.random.default_rng(1)
    recordings = [record(rng, lambda q, v: 0.0, number, gain=0.7) for number in range(2)]
    known = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    windows = known.windows()
    judged = judging(known.model(windows), windows, [GAIN])
    refit, corrected = (fit.by_window.sum() for fit in (judged.null, judged.best))
    assert refit < 2.0 * corrected
    assert judged.share(GAIN) > 0.9
    assert decide.closes_most(judged, windows)


@pytest.mark.parametrize("helps", [True, False])
def test_the_spread_of_a_plant_with_a_learned_force_is_that_of_the_numbers_without_it(
    rubbing: tuple[PlantModel, Windows], helps: bool
) -> None:
    result, best = searched(*rubbing, [FRICTION])
    judged = weighed(result, best, result.null, rubbing[1])
    base = judged.best if helps else judged.null
    force = GridForce("pendulum", (Axis("velocity", -6.0, 6.0, 9),), 0.2 * np.eye(9)[:, 2:7])
    learned = replace(
        base, model=replace(base.model, learned=(force,)), theta=np.append(base.theta, np.ones(5))
    )
    assert spread_of(result, judged, learned) == spread_of(result, judged, base)


def test_what_is_left_is_told_in_newtons_beside_what_the_nominal_plant_leaves(
    rubbing: tuple[PlantModel, Windows],
) -> None:
    result, best = searched(*rubbing, [FRICTION])
    (left,) = left_forces(weighed(result, best, result.null, rubbing[1]))
    assert left.joint == "pendulum"
    assert left.unit == "N m"
    assert left.std < 0.01 < 0.05 < left.nominal < 0.2
    usual = best.model.scales["pendulum"].force
    assert left.usual == pytest.approx(left.std / usual)


@pytest.mark.parametrize(("value", "low", "sure"), [(0.1, -0.05, 0.81), (0.1, 0.05, 0.9999)])
def test_a_probability_agrees_with_the_interval(value: float, low: float, sure: float) -> None:
    """Beside an interval that holds 0 it is below 95 %."""
    estimates = {"k": EstimatedParameter(value, low, 2.0 * value - low, "N m/rad")}
    assert decide._present(SPRING, estimates) == pytest.approx(sure, abs=0.01)


@pytest.mark.parametrize(("stds", "told"), [(4.0, False), (6.0, True)])
def test_a_parameter_far_from_its_prior_is_told(
    rubbing: tuple[PlantModel, Windows], stds: float, told: bool
) -> None:
    fit = with_effects(*rubbing, [])
    theta = np.zeros_like(fit.theta)
    name, std = next(iter(fit.model.priors.items()))
    theta[0] = stds * std
    shifted = shifted_parameters(replace(fit, theta=theta))
    assert [each.name for each in shifted] == ([name] if told else [])
    for each in shifted:
        assert each.stds == pytest.approx(stds)
        assert each.value == pytest.approx(each.nominal * (1.0 + stds * std))
        assert each.stds > VERDICT.shifted


@pytest.mark.parametrize("turned", [False, True])
def test_a_family_holds_what_stands_for_several_effects_together(turned: bool) -> None:
    """A motor under a voltage is about a viscous friction and a lag."""

    def fit(*effects: EffectInstance) -> Any:
        return SimpleNamespace(model=SimpleNamespace(effects=effects))

    motor, viscous, lag, delay = (
        EffectInstance(
            CATALOGUE[name], "pendulum" if name in ("back_emf", "viscous_friction") else "actuator"
        )
        for name in ("back_emf", "viscous_friction", "actuator_lag", "actuator_delay")
    )
    one, two, others = fit(motor), fit(viscous, lag), fit(viscous, delay)
    first, second = (two, one) if turned else (one, two)
    ranked = (first, 0.0), (second, 0.5 * VERDICT.tied), (others, 0.6 * VERDICT.tied)
    result: Any = SimpleNamespace(best=first, ranked=ranked)
    told = {each: {r.instance for r in rivals(result, each)} for each in first.model.effects}
    if turned:
        assert told == {viscous: {motor}, lag: {motor, delay}}
    else:
        assert told == {motor: {viscous, lag}}


def test_what_takes_the_place_of_an_effect_in_likelier_models_is_in_its_family() -> None:
    """As a spring beside a friction, where it is a hardening spring that was found alone."""

    def fit(*effects: EffectInstance) -> Any:
        return SimpleNamespace(model=SimpleNamespace(effects=effects))

    names = "hardening_spring", "spring", "dahl_friction"
    hard, soft, cable = (EffectInstance(CATALOGUE[name], "pendulum") for name in names)
    best = fit(hard)
    likelier = [(fit(soft, cable), -78.0), (fit(hard, cable), -80.0)]
    for others, apart in (
        (likelier, 2.0),
        ([(fit(soft, cable), -58.0), likelier[1]], None),  # which is not as likely
        ([(fit(soft, cable), -8.0), (fit(hard, cable), -10.0)], None),  # as likely as the best
        (likelier[:1], None),
    ):
        result: Any = SimpleNamespace(best=best, ranked=((best, 0.0), *others))
        told = rivals(result, hard)
        assert [(each.instance, each.behind) for each in told] == (
            [] if apart is None else [(soft, apart)]
        )
        sure = 1.0 if apart is None else 1.0 / (1.0 + math.exp(-0.5 * apart))
        assert decide._probability(result, hard) == pytest.approx(sure)


@pytest.mark.parametrize(
    ("contexts", "sure"),
    [
        ([("asymmetric_friction", "coulomb_friction", 2.0)], 1.0 / (1.0 + math.exp(-1.0))),
        ([("asymmetric_friction", "coulomb_friction", -700.0)], 0.5),
        ([("asymmetric_friction", "coulomb_friction", -700.0)] * 3, 0.5),
        (
            [
                ("asymmetric_friction", "coulomb_friction", -700.0),
                ("asymmetric_friction", "stribeck_friction", -9.0),
            ],
            1.0 / 3.0,
        ),
        ([("coulomb_friction", "asymmetric_friction", -700.0)], 1.0),
    ],
)
def test_a_rival_beside_likelier_effects_counts_once_and_not_more_than_the_effect(
    contexts: list[tuple[str, str, float]], sure: float
) -> None:
    """And one of which the effect is a special case says nothing against it."""

    def fit(*effects: EffectInstance) -> Any:
        return SimpleNamespace(model=SimpleNamespace(effects=effects))

    friction = EffectInstance(CATALOGUE[contexts[0][0]], "pendulum")
    best, places = fit(friction), ("spring", "hardening_spring", "dahl_friction")
    ranked = [(best, 0.0)]
    for (_, other, behind), place in zip(contexts, places, strict=False):
        beside = EffectInstance(CATALOGUE[place], "pendulum")
        rival = EffectInstance(CATALOGUE[other], "pendulum")
        ranked += [(fit(rival, beside), behind - 900.0), (fit(friction, beside), -900.0)]
    result: Any = SimpleNamespace(best=best, ranked=tuple(ranked))
    assert len(rivals(result, friction)) == len(contexts)
    assert decide._probability(result, friction) == pytest.approx(sure)


def test_what_lies_on_a_bound_is_told(rubbing: tuple[PlantModel, Windows]) -> None:
    fit = with_effects(*rubbing, [FRICTION])
    (span,) = fit.model.spans()
    for number, end in enumerate(fit.model.bounds):
        theta = fit.theta.copy()
        theta[span][1] = end[span][1]
        (said,) = on_bounds(replace(fit, theta=theta))
        assert said.startswith("v_r of coulomb_friction (pendulum) lies on its")
        assert ("lower", "upper")[number] in said
    theta = fit.theta.copy()
    theta[span][1] = fit.model.bounds[0][span][1] + 0.1
    assert on_bounds(replace(fit, theta=theta)) == ()
