"""The choice of a model, its names, and the verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float

import envs
from mcpilco.gap import decide
from mcpilco.gap.comparison import Interval
from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.decide import certain, fewest
from mcpilco.gap.fit import Fit, ResidualStructure, fit_initial_states, fit_model
from mcpilco.gap.plant_model import PlantModel
from mcpilco.gap.residual_force import ExplainedForce
from mcpilco.gap.search import SearchResult, promising
from mcpilco.gap.thresholds import CHOICE
from mcpilco.plant import CATALOGUE, EffectInstance
from tests.mcpilco.gap.pendulum import dry_friction, record

WHITE = ResidualStructure(whiteness=2.0, excess=0.0, usual=0.0, unevenness=1.5)


@pytest.fixture(scope="module")
def nominal() -> tuple[Fit, Windows]:
    """The nominal fit of recordings in which nothing is hidden."""
    rng = np.random.default_rng(0)
    measured = [record(rng, lambda q, v: 0.0, number) for number in range(2)]
    problem = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), measured, 0.01, (), {})
    windows = problem.windows()
    model = problem.model(windows)
    theta = np.zeros(model.nuisances)
    return fit_model(model, windows, theta, fit_initial_states(model, windows, theta)), windows


def missed(found: Fit, windows: Windows, usual: float, once: float) -> Fit:
    """The fit, its windows missed alike but for one."""
    by_window = usual * windows.samples
    by_window[3] = once * windows.samples[3]
    return replace(found, by_window=by_window, chi2=float(by_window.sum()))


@pytest.mark.parametrize(
    ("usual", "left", "gap", "unknown"),
    [
        pytest.param(1.0, 9.0, 9.0, True, id="missed-once"),
        pytest.param(1.0, 3.0, 300.0, False, id="mended-for-the-most-part"),
        pytest.param(3.0, 4.0, 4.0, False, id="noise-is-larger-than-told"),
        pytest.param(3.0, 9.0, 9.0, True, id="missed-once-in-such-noise"),
        pytest.param(40.0, 200.0, 200.0, False, id="a-machine-that-no-model-fits"),
    ],
)
def test_a_window_that_is_missed_alone_is_not_passed_over(
    nominal: tuple[Fit, Windows],
    monkeypatch: pytest.MonkeyPatch,
    usual: float,
    left: float,
    gap: float,
    unknown: bool,
) -> None:
    found, windows = nominal
    best, null = (missed(found, windows, usual, once) for once in (left, gap))
    monkeypatch.setattr(decide, "structure", lambda found, windows: WHITE)
    assert decide.misses_something(best, null, windows) == unknown


def test_noise_alone_is_nothing_else(nominal: tuple[Fit, Windows]) -> None:
    found, windows = nominal
    assert not decide.misses_something(found, found, windows)


@pytest.mark.parametrize(
    ("closed", "low", "held_out", "fitted", "usual", "bad"),
    [
        (0.9, 0.8, 50.0, 1.0, 1.0, False),
        (0.3, 0.2, 1.2, 1.0, 1.0, False),
        (0.3, 0.2, 4.0, 1.0, 1.0, True),
        (0.3, 0.2, 4.0, 3.0, 1.0, False),
        (0.6, 0.2, 4.0, 1.0, 1.0, False),
        (0.6, 0.2, 4.0, 3.0, 50.0, True),
        (0.6, 0.55, 4.0, 3.0, 50.0, False),
    ],
)
def test_effects_that_leave_the_held_out_error_are_not_what_is_missing(
    nominal: tuple[Fit, Windows],
    monkeypatch: pytest.MonkeyPatch,
    closed: float,
    low: float,
    held_out: float,
    fitted: float,
    usual: float,
    bad: bool,
) -> None:
    null, windows = nominal
    armature = EffectInstance(CATALOGUE["armature"], "pendulum")
    model, theta = null.model.grown(null.theta, armature, [0.01])
    best = replace(missed(null, windows, usual, usual), model=model, theta=theta)
    clear = windows[:5]
    beyond = {len(windows): fitted, len(clear): held_out}
    monkeypatch.setattr(decide, "error_reduction", lambda *fits: Interval(closed, low, 1.0))
    monkeypatch.setattr(decide, "error_over_noise", lambda found, some: beyond[len(some)])
    assert decide.mispredicts(best, null, windows, clear) == bad
    assert not decide.mispredicts(null, null, windows, clear)


@pytest.mark.parametrize(("usual", "unknown"), [(0.5, False), (50.0, True)])
def test_a_gap_that_is_closed_in_few_windows_alone_is_not_named(
    nominal: tuple[Fit, Windows], monkeypatch: pytest.MonkeyPatch, usual: float, unknown: bool
) -> None:
    """Few windows make nearly all of the misfit: they are explained, the usual ones are not."""
    found, windows = nominal
    told = iter(
        (
            ResidualStructure(whiteness=1e4, excess=60.0, usual=usual, unevenness=1.5),
            ResidualStructure(whiteness=1e4, excess=1e5, usual=60.0, unevenness=900.0),
        )
    )
    monkeypatch.setattr(decide, "structure", lambda found, windows: next(told))
    monkeypatch.setattr(
        decide, "explained_by_forces", lambda response: ExplainedForce(0.0, np.zeros(1))
    )
    assert decide.misses_something(found, found, windows) == unknown


WINDOWS = 40


EFFECTS = np.array([0, 1, 2])


def log_misfits(first: float, second: float, spread: float) -> Float[np.ndarray, "3 W"]:
    """Log misfits of models of none, one and two effects; `second` is sure to within `spread`."""
    one, two = 3.0 - first, 3.0 - first - second
    scatter = spread * np.resize([1.0, -1.0], WINDOWS)
    return np.stack([np.full(WINDOWS, 3.0), np.full(WINDOWS, one), two + scatter])


@pytest.mark.parametrize(("second", "effects"), [(1.0, 2), (0.2, 1), (-0.2, 1)])
def test_an_effect_is_taken_where_it_predicts_surely_better(second: float, effects: int) -> None:
    assert fewest(log_misfits(1.0, second, 2.0), EFFECTS, EFFECTS, 1.0) == effects


def test_an_effect_that_gains_next_to_nothing_is_not_taken_however_sure() -> None:
    assert fewest(log_misfits(1.0, 0.05, 1e-3), EFFECTS, EFFECTS, 1.0) == 1


def test_windows_that_overlap_count_once() -> None:
    found = log_misfits(0.0, 1.0, 2.0)
    assert fewest(found, EFFECTS, EFFECTS, 1.0) == 2
    assert fewest(found, EFFECTS, EFFECTS, 20.0) == 0


def test_of_as_many_effects_that_with_the_fewest_numbers_is_taken() -> None:
    found = log_misfits(1.0, 0.2, 2.0)[1:]
    assert fewest(found, np.array([1, 1]), np.array([2, 1]), 1.0) == 1
    assert fewest(found, np.array([1, 1]), np.array([1, 2]), 1.0) == 0


def test_fewer_numbers_come_before_fewer_effects() -> None:
    """Two Coulomb frictions and an offset before two frictions that differ by direction."""
    found = log_misfits(1.0, 0.2, 2.0)[1:]
    assert fewest(found, np.array([2, 3]), np.array([4, 3]), 1.0) == 1


def fit_of(*names: str, chi2: float) -> Fit:
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    named = tuple(EffectInstance(CATALOGUE[name], "pendulum") for name in names)
    return Fit(PlantModel(plant, named, {}, {}), np.empty(0), np.empty((0, 2)), chi2, np.empty(0))


def test_special_cases_of_promising_models_are_promising_and_bad_ones_are_not() -> None:
    general = "spring", "hardening_spring", "position_ripple", "viscous_friction", "quadratic_drag"
    pairs = [
        fit_of("asymmetric_friction", other, chi2=1.0) for other in general[: CHOICE.of_each_size]
    ]
    plain = fit_of("coulomb_friction", "spring", chi2=2.0)
    other = fit_of("stribeck_friction", "spring", chi2=1.5)
    bad = fit_of("coulomb_friction", "quadratic_drag", chi2=4.0)
    single = fit_of("spring", chi2=2.9)
    kept = promising([*pairs, other, plain, single, bad])
    assert [known for known in (plain, single, other, bad) if any(known is k for k in kept)] == [
        plain,
        single,
    ]


FRICTION = EffectInstance(CATALOGUE["coulomb_friction"], "pendulum")


SPRING = EffectInstance(CATALOGUE["spring"], "pendulum")


OFFSET = EffectInstance(CATALOGUE["sensor_offset"], "angle")


SIZES = {FRICTION: (0.1, 2e-3), SPRING: (0.02,), OFFSET: (0.01,)}


@pytest.fixture(scope="module")
def rubbing() -> tuple[PlantModel, Windows]:
    """Windows of a pendulum with Coulomb friction, and the model without effects."""
    rng = np.random.default_rng(0)
    recordings = [record(rng, dry_friction(0.1), number) for number in range(2)]
    known = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    windows = known.windows()
    return known.model(windows), windows


def found(
    nominal: PlantModel, windows: Windows, effects: list[EffectInstance]
) -> tuple[SearchResult, Fit]:
    """A search that ended with these effects, and their fit."""
    model, theta = nominal, np.zeros(nominal.nuisances)
    null = fit_model(model, windows, theta, fit_initial_states(model, windows, theta))
    for active in effects:
        model, theta = model.grown(theta, active, SIZES[active])
    best = fit_model(model, windows, theta, fit_initial_states(model, windows, theta))
    return SearchResult(best, null, (), (), windows).with_best(best, [null, best]), best


@pytest.mark.parametrize(
    "none", [[SPRING], [OFFSET], [SPRING, OFFSET]], ids=["spring", "offset", "both"]
)
def test_effects_that_may_be_none_are_not_named(
    rubbing: tuple[PlantModel, Windows], none: list[EffectInstance]
) -> None:
    nominal, windows = rubbing
    before, best = found(nominal, windows, [FRICTION, *none])
    search, kept, names = certain(before, best, before.null, windows)
    assert search.best.model.effects == kept.model.effects == (FRICTION,)
    assert {frozenset(f.model.effects) for f in before.fits} < {
        frozenset(f.model.effects) for f in search.fits
    }
    (named,) = names
    assert named.parameters["f_c"].low < 0.1 < named.parameters["f_c"].high


def test_an_effect_alone_that_may_be_none_is_not_named(rubbing: tuple[PlantModel, Windows]) -> None:
    nominal, windows = rubbing
    friction = nominal.plant.having([(FRICTION, (0.1, 2e-3))])
    before, best = found(replace(nominal, plant=friction), windows, [SPRING])
    search, kept, names = certain(before, best, before.null, windows)
    assert not search.best.model.effects
    assert not kept.model.effects
    assert names == ()
