"""Errors of free runs on held-out windows, with their intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcpilco.gap import Gap, Windows, comparison
from mcpilco.gap.comparison import (
    closed_interval,
    compare,
    error_reduction,
    free_run,
    misfit_over_expected,
    rms_interval,
    scaled_errors,
    squares_at_end,
)
from mcpilco.gap.disturbance import Disturbance, Evidence
from mcpilco.gap.fit import Fit, on_windows
from mcpilco.gap.report import summary
from mcpilco.gap.search import SearchResult, nested_fits
from mcpilco.gap.sensitivities import run
from mcpilco.plant import EffectInstance
from mcpilco.show.report.gap_page import cautions


def test_errors_shrink_step_by_step_from_the_nominal_plant_to_the_corrected_one(found: Gap) -> None:
    assert found.comparison is not None
    steps = found.comparison.steps
    assert [step.added for step in steps] == [
        "nominal",
        "parameters refitted",
        "coulomb_friction (pendulum)",
    ]
    assert steps[0].error.value == found.comparison.nominal
    assert steps[-1].error.value == found.comparison.corrected
    for step in steps:
        assert step.error.low <= step.error.value <= step.error.high
    assert steps[-1].error.high < steps[1].error.low


def test_errors_over_time_lie_within_their_bands_and_grow_only_without_the_effect(
    found: Gap,
) -> None:
    assert found.comparison is not None
    for name, values in found.comparison.over_time.items():
        seen = np.isfinite(values)
        low, high = found.comparison.bands[name][:, seen]
        assert np.all((low <= values[seen]) & (values[seen] <= high))
    end = {name: values[-1] for name, values in found.comparison.over_time.items()}
    assert end["nominal"] > 10.0 > 2.0 > end["corrected"]
    assert 0.5 < end["noise_floor"] < 2.0


def test_errors_over_all_windows_count_those_with_events(found: Gap) -> None:
    assert found.comparison is not None
    assert found.models is not None
    windows = found.comparison.windows
    pushed = windows.y.copy()
    pushed[0, 0, -20:] += 0.5
    whole = compare(found.models, windows, replace(windows, y=pushed))
    alike = compare(found.models, windows)
    assert whole.corrected == alike.corrected == pytest.approx(alike.everywhere["corrected"])
    assert whole.everywhere["corrected"] > 5.0 * whole.corrected


def test_noise_hides_a_gap_that_is_no_larger_than_what_it_does(found: Gap) -> None:
    assert found.comparison is not None
    assert found.models is not None
    assert not found.comparison.hidden
    assert not any("noise hides" in line for line in [*summary(found), *cautions(found)])
    mended = replace(found.models.nominal, plant=found.corrected)
    comparison = compare(replace(found.models, nominal=mended), found.comparison.windows)
    assert comparison.hidden
    hidden = replace(found, comparison=comparison)
    lines = summary(hidden)
    assert any("noise hides" in line for line in lines)
    assert not any(line.startswith("The gap is closed") for line in lines)
    assert any("noise hides" in line for line in cautions(hidden))


def test_only_the_corrected_plant_predicts_as_well_as_can_be_expected(found: Gap) -> None:
    assert found.comparison is not None
    assert found.models is not None
    assert found.search is not None
    models, held_out = found.models, (found.comparison.windows, found.search.evidence)
    fits = models.corrected, models.refit
    corrected, refit = (misfit_over_expected(fit, *held_out) for fit in fits)
    assert corrected == pytest.approx(1.0, abs=0.15)
    assert refit > 5.0


@pytest.mark.parametrize("std", [0.0, 0.05])
def test_the_expected_error_is_that_which_noise_and_random_forces_make(
    found: Gap, std: float
) -> None:
    assert found.comparison is not None
    assert found.models is not None
    fit, windows = found.models.corrected, found.comparison.windows.plain
    evidence = Evidence(0.0, np.array([std]), np.array([1.5, 1.5]), 1000, np.zeros(2))
    fit, rng = on_windows(fit, windows), np.random.default_rng(0)
    disturbance, draws = Disturbance.of(fit, windows), []
    true = run(fit.model, windows, fit.theta[None], fit.x0[None])[0]
    for _ in range(30):
        force = std * rng.standard_normal((len(windows), disturbance.columns.shape[2]))
        moved = np.einsum("wnm,wm->wn", disturbance.columns, force).reshape(windows.y.shape)
        y = true + windows.std[:, None] * (moved + 1.5 * rng.standard_normal(true.shape))
        shaken = replace(windows, y=np.where(windows.measured, y, np.nan))
        errors = scaled_errors(shaken, free_run(fit.model, fit.theta, shaken))
        draws.append(squares_at_end(errors))
    expected = comparison.expected_squares(fit, windows, evidence)
    assert np.mean(draws) == pytest.approx(expected.mean(), rel=0.15)
    if std:  # else it is alike in all windows
        assert np.corrcoef(np.mean(draws, axis=0).ravel(), expected.ravel())[0, 1] > 0.5


def test_a_window_that_nobody_can_foresee_does_not_decide(
    found: Gap, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert found.comparison is not None
    assert found.models is not None
    assert found.search is not None
    windows, wild = found.comparison.windows, 50.0
    expected: np.ndarray = np.ones((len(windows), 1))
    expected[0] = wild**2

    def error(some: Windows, y: np.ndarray) -> np.ndarray:
        errors = np.full(some.y.shape, 0.5 if y is after else 1.0)
        errors[0] *= 4.0 * wild
        return errors

    before, after = (np.zeros(windows.y.shape) for _ in range(2))
    runs = iter((before, after))
    monkeypatch.setattr(comparison, "predictable", lambda found, windows: windows)
    monkeypatch.setattr(comparison, "expected_squares", lambda *_: expected)
    monkeypatch.setattr(comparison, "free_run", lambda *_: next(runs))
    monkeypatch.setattr(comparison, "scaled_errors", error)
    told = found.models.corrected, windows, found.search.evidence
    assert error_reduction(found.models.refit, *told).value == pytest.approx(0.5)


def test_the_way_to_three_effects_leads_over_the_best_one_and_the_best_two_with_it(
    found: Gap,
) -> None:
    assert found.search is not None
    null = found.search.null
    a, b, c = found.plant.candidates()[:3]
    sets = [(a, b, c), (a, b), (b, c), (c,), (a,), ()]  # the best first

    def fitted(effects: tuple[EffectInstance, ...]) -> Fit:
        return replace(null, model=replace(null.model, added=effects))

    fits = [fitted(effects) for effects in sets]
    ranked = tuple((known, float(bic)) for bic, known in enumerate(fits))
    way = nested_fits(
        SearchResult(fits[0], null, ranked, (), found.search.windows, found.search.evidence),
        fits[0],
    )
    assert [known.model.effects for known in way] == [(c,), (b, c)]


def ends_of_windows(
    rng: np.random.Generator, W: int, overlap: float, joints: int
) -> tuple[np.ndarray, Windows]:
    """Errors in noise std, (W, joints), each the sum of what happened in its window; its windows.

    They are normal, of standard deviation 1.
    """
    T = 35
    stride = round(T / overlap)
    steps = np.cumsum(rng.standard_normal((W * stride + T + 1, joints)), axis=0)
    first = stride * np.arange(W)
    windows = Windows(
        y=np.zeros((W, 2 * joints, T)),
        commands=np.zeros((W, T, 1)),
        path=np.zeros((W, T, 2 * joints)),
        lead=0,
        dt=0.02,
        std=np.ones(2 * joints),
        guess=np.zeros((W, 2 * joints)),
        recording=np.zeros(W, dtype=int),
        start_s=0.02 * first,
        overlap=overlap,
    )
    return (steps[first + T] - steps[first]) / np.sqrt(T), windows


@pytest.mark.slow
@pytest.mark.parametrize("overlap", [1.0, 3.5])
@pytest.mark.parametrize(("W", "joints"), [(4, 1), (8, 2), (30, 1)])
def test_intervals_hold_the_true_error_and_the_true_share_in_95_percent(
    overlap: float, W: int, joints: int
) -> None:
    rng, tried = np.random.default_rng(0), 500
    held = np.zeros(2)
    for _ in range(tried):
        (before, windows), (after, _) = (ends_of_windows(rng, W, overlap, joints) for _ in "ab")
        error = rms_interval(before**2, windows)
        floor = np.full_like(before, 0.01)
        squares = {"nominal": before**2, "corrected": (0.3 * after) ** 2, "noise_floor": floor}
        share = closed_interval(squares, "nominal", windows)
        assert error.low < error.value < error.high
        held += [error.low <= 1.0 <= error.high, share.low <= 0.7 / 0.9 <= share.high]
    assert 0.9 <= held[0] / tried <= 0.98
    assert 0.9 <= held[1] / tried <= 0.98


def test_a_single_window_is_sure_of_nothing() -> None:
    errors, windows = ends_of_windows(np.random.default_rng(0), 1, 1.0, 2)
    found = rms_interval(errors**2, windows)
    assert (found.low, found.high) == (0.0, np.inf)
