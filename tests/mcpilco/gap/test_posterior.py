"""The errors of a fit's numbers: a jackknife over windows, and forces that are alike in all."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.disturbance import Disturbance
from mcpilco.gap.fit import Fit, nearer
from mcpilco.gap.posterior import Posterior, lasting
from mcpilco.gap.sensitivities import linearise, residual, run
from mcpilco.plant import CATALOGUE, EffectInstance


def fitted(P: np.ndarray, r: np.ndarray) -> tuple[Any, Any]:
    """A least-squares fit of two numbers, of which residuals are linear, and its windows."""
    theta = np.linalg.lstsq(P.reshape(-1, 2), r.reshape(-1))[0]
    lin = SimpleNamespace(Jp=P, cleaned=lambda columns: columns, r=r - P @ theta)
    model = SimpleNamespace(precision=np.zeros(2))
    return SimpleNamespace(model=model, theta=theta, linearised=lambda _: lin), Many(len(r))


def nothing_lasts(r: np.ndarray) -> np.ndarray:
    """The response to no force that is alike in all windows."""
    return np.zeros((*r.shape, 0))


@pytest.fixture
def linear() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """The estimate and its covariance, of windows whose residuals are linear in two numbers."""

    def solved(
        P: np.ndarray, r: np.ndarray, force: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        fit, windows = fitted(P, r)
        force = nothing_lasts(r) if force is None else force
        return fit.theta, Posterior(fit, windows, force).covariance

    return solved


class Many(list):
    """So many windows, side by side."""

    overlap = 1.0

    def __init__(self, number: int) -> None:
        super().__init__(range(number))


def test_the_covariance_is_that_of_fits_that_leave_out_a_window_each(linear: Callable) -> None:
    rng = np.random.default_rng(0)
    P, r = rng.normal(size=(6, 5, 2)), rng.normal(size=(6, 5))
    theta, found = linear(P, r)
    left = [linear(np.delete(P, w, axis=0), np.delete(r, w, axis=0))[0] - theta for w in range(6)]
    np.testing.assert_allclose(found, np.transpose(left) @ left * 5 / 6, rtol=1e-9)


def test_intervals_hold_the_truth_where_few_windows_lead(linear: Callable) -> None:
    """Twelve windows, one of which tells as much as the others, errors that a window shares."""
    rng, held = np.random.default_rng(1), 0
    for _ in range(400):
        P = rng.normal(size=(12, 5, 2)) * np.where(np.arange(12) == 0, 3.0, 1.0)[:, None, None]
        r = rng.normal(size=(12, 5)) + rng.normal(size=(12, 1))
        theta, found = linear(P, r)
        held += abs(theta[0]) < stats.t.ppf(0.975, 11) * np.sqrt(found[0, 0])
    assert 0.93 < held / 400 < 0.99


def test_two_numbers_that_are_0_are_told_apart_from_it_as_rarely_as_one() -> None:
    rng, alone, together = np.random.default_rng(3), 0, 0
    for _ in range(800):
        P = rng.normal(size=(12, 5, 2))
        r = rng.normal(size=(12, 5)) + rng.normal(size=(12, 1))
        solved = Posterior(*fitted(P, r), nothing_lasts(r))
        std = np.sqrt(np.diag(solved.covariance))
        alone += bool((np.abs(solved.fit.theta) > stats.t.ppf(0.975, 11) * std).any())
        together += solved.confidence([0, 1]) > 0.95
    assert 0.03 < together / 800 < 0.07 < 0.08 < alone / 800


@pytest.mark.parametrize(("considered", "least", "most"), [(True, 0.93, 0.98), (False, 0.0, 0.5)])
def test_a_force_that_is_alike_in_all_windows_is_considered(
    linear: Callable, considered: bool, least: float, most: float
) -> None:
    """It goes into the estimate, and no window that is left out can tell."""
    rng, held = np.random.default_rng(2), 0
    for _ in range(400):
        P = rng.normal(size=(12, 5, 2))
        force = 0.7 * P[:, :, :1] + rng.normal(size=(12, 5, 1))
        r = rng.normal(size=(12, 5)) + force[:, :, 0] * rng.normal()
        theta, found = linear(P, r, force if considered else None)
        held += abs(theta[0]) < stats.t.ppf(0.975, 11) * np.sqrt(found[0, 0])
    assert least < held / 400 < most


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("constant_force", [1e-3]),
        ("spring", [1e-3]),
        ("viscous_friction", [1e-3]),
        ("coulomb_friction", [1e-3, 0.01]),
    ],
)
def test_a_force_that_lasts_moves_the_plant_as_the_effect_of_its_law(
    lagging: tuple[GapProblem, Windows, Fit], name: str, values: list[float]
) -> None:
    _, windows, fit = lagging
    fit = nearer(fit, windows)
    law = EffectInstance(CATALOGUE[name], "pendulum")
    model, theta = fit.model.grown(fit.theta, law, values)
    if (parameter := fit.model.frees(law)) is not None:  # the plant has some of it already
        theta = theta + values[0] * np.eye(len(theta))[parameter]
    with_law = run(model, windows, theta[None], fit.x0[None])[0]
    without = run(fit.model, windows, fit.theta[None], fit.x0[None])[0]
    moved = residual(windows, without) - residual(windows, with_law)
    columns = lasting(Disturbance.of(fit, windows), fit, windows, np.array([0.03]))
    lin = linearise(fit.model, windows, fit.theta, fit.x0)
    expected, *found = lin.cleaned(np.concatenate([moved[:, :, None], columns], axis=2)).T
    alike = [np.vdot(expected, f) / np.linalg.norm(expected) / np.linalg.norm(f) for f in found]
    assert max(np.abs(alike)) > (0.99 if len(values) == 1 else 0.9)  # held while a speed turns over
