"""The random forces beside the equations: their likelihood, their sizes, and what is white."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from jaxtyping import Float
from scipy.linalg import block_diag, toeplitz
from scipy.optimize import minimize, minimize_scalar

import envs
from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.disturbance import Disturbance, _GivenNoise, _Likelihood
from mcpilco.gap.fit import Fit, fit_nominal, misfits, nearer
from mcpilco.gap.sensitivities import lean, residual, run
from mcpilco.gap.thresholds import DISTURBANCE, FORCE, VERDICT
from tests.mcpilco.gap.lagging import fitted, problem

STD = 0.03
"""of a random force [usual forces]"""


def disturbed(
    seed: int, std: float, noise: float | tuple[float, float] = 1.0, correlation: float = 0.0
) -> tuple[Fit, Windows, Disturbance]:
    """A pendulum's windows as random forces and noise make them about its own motion.

    Velocities are read too where they have a noise of their own.
    """
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [])
    windows = known.windows()
    if isinstance(noise, tuple):
        y = np.repeat(windows.y[:, :1], 2, axis=1)
        windows = replace(windows, y=y, std=np.array([windows.std[0], 10.0 * windows.std[0]]))
    model = known.model(windows)
    theta, rng = np.zeros(model.nuisances), np.random.default_rng(seed)
    fit = fitted(model, windows, theta)
    fit = replace(fit, theta=theta)
    true = run(model, windows, theta[None], fit.x0[None])[0]
    disturbance = Disturbance.of(fit, windows)
    force = rng.normal(0.0, std, (len(windows), disturbance.columns.shape[2]))
    moved = np.einsum("wnm,wm->wn", disturbance.columns, force).reshape(windows.y.shape)
    size = np.broadcast_to(np.array(noise), 2)[:, None]
    measured = rng.standard_normal(windows.y.shape)
    for t in range(1, measured.shape[2]):
        new = np.sqrt(1.0 - correlation**2) * measured[:, :, t]
        measured[:, :, t] = correlation * measured[:, :, t - 1] + new
    measured *= size
    y = true + windows.std[:, None] * (moved + measured)
    windows = replace(windows, y=np.where(windows.measured, y, np.nan))
    return fit, windows, Disturbance.of(fit, windows)


def noise_covariance(windows: Windows, noise: np.ndarray, correlation: np.ndarray) -> np.ndarray:
    """Of all readings of a window, those of each state one after the other."""
    lags = np.arange(windows.y.shape[2])
    parts = zip(noise, correlation, strict=True)
    return np.asarray(block_diag(*(std**2 * toeplitz(part**lags) for std, part in parts)))


def dense_deviance(
    fit: Fit,
    disturbance: Disturbance,
    std: np.ndarray,
    noise: np.ndarray,
    correlation: np.ndarray,
) -> float:
    """-2 log likelihood of the residuals' parts that no start makes, by their whole covariance."""
    windows = disturbance.windows
    lin = lean(fit.model, windows, fit.theta, nearer(fit, windows).x0)
    total = 0.0
    for w in range(len(windows)):
        seen = windows.measured[w].ravel()
        start = np.linalg.svd(lin.Jx[w][seen])[0][:, lin.Jx.shape[2] :].T
        G = start @ disturbance.columns[w][seen] * std[disturbance.joint]
        noisy = noise_covariance(windows, noise, correlation)[np.ix_(seen, seen)]
        covariance = start @ noisy @ start.T + G @ G.T
        r = start @ lin.r[w][seen]
        total += np.linalg.slogdet(covariance)[1] + r @ np.linalg.solve(covariance, r)
    return total


def test_the_deviance_is_that_of_a_normal_distribution_with_the_whole_covariance() -> None:
    fit, _, disturbance = disturbed(0, STD, correlation=0.4)
    found = disturbance.evidence(fit)
    assert found.correlation[0] > 0.2
    expected = dense_deviance(fit, disturbance, found.std, found.noise, found.correlation)
    assert found.deviance == pytest.approx(expected, rel=1e-6)


def test_no_other_size_is_likelier() -> None:
    fit, _, disturbance = disturbed(1, STD, correlation=0.3)
    found = disturbance.evidence(fit)
    least = dense_deviance(fit, disturbance, found.std, found.noise, found.correlation)
    sizes = (1.2, 1.0, 0.0), (0.8, 1.0, 0.0), (1.0, 1.05, 0.0), (1.0, 0.95, 0.0)
    for times, louder, more in (*sizes, (1.0, 1.0, 0.06), (1.0, 1.0, -0.06)):
        other = times * found.std, louder * found.noise, found.correlation + more
        assert dense_deviance(fit, disturbance, *other) > least


def test_the_gain_of_a_force_is_that_over_more_noise_in_its_place() -> None:
    fit, _, disturbance = disturbed(0, STD)
    found = disturbance.evidence(fit)

    def without(times: float) -> float:
        noise = times * found.noise
        return dense_deviance(fit, disturbance, 0.0 * found.std, noise, found.correlation)

    least = minimize_scalar(without, bounds=(0.5, 10.0), method="bounded").fun
    assert found.gain == pytest.approx(least - found.deviance, rel=1e-4)
    assert found.deficient


def test_a_force_that_hardly_moves_a_joint_may_be_none_whatever_size_fits_best() -> None:
    """As in a joint that its dry friction holds, of which noise says next to nothing."""
    faint = []
    for seed in range(12):
        fit, _, disturbance = disturbed(seed, 0.0)
        faint.append(replace(disturbance, columns=0.003 * disturbance.columns).evidence(fit))
    assert max(each.std[0] for each in faint) > VERDICT.force
    assert not any(each.deficient for each in faint)
    assert max(each.sure[0] for each in faint) <= VERDICT.force


def two_joints(seed: int, std: tuple[float, float]) -> _GivenNoise:
    """The likelihood of readings that random forces in two joints moved, and noise."""
    rng = np.random.default_rng(seed)
    G, joint = rng.normal(size=(40, 24, 10)), np.repeat([0, 1], 5)
    force = rng.normal(size=(40, 10)) * np.array(std)[joint]
    r = np.einsum("wni,wi->wn", G, force) + rng.normal(size=(40, 24))
    basis = np.linalg.qr(rng.normal(size=(40, 24, 2)))[0]
    whole = _Likelihood(r[:, :, None], G, basis, np.ones((40, 2, 12), dtype=bool), joint)
    return _GivenNoise.of(whole, np.array([1.0, 1.3]), np.array([0.2, 0.0]))


@pytest.mark.parametrize("at", [(-1.0, 0.5), (-12.0, 3.0)])
def test_slope_and_curvature_are_those_of_the_deviance(at: tuple[float, float]) -> None:
    given, x, step = two_joints(0, (0.5, 1.0)), np.array(at), 1e-4
    _, slope, bend, _ = given(x)
    for j, nudge in enumerate(step * np.eye(2)):
        above, below = given(x + nudge), given(x - nudge)
        assert slope[j] == pytest.approx((above[0] - below[0]) / (2.0 * step), abs=1e-4, rel=1e-5)
        assert bend[j] == pytest.approx((above[1] - below[1]) / (2.0 * step), abs=1e-4, rel=1e-5)


@pytest.mark.parametrize("std", [(0.5, 2.0), (0.0, 0.3), (30.0, 0.0), (0.0, 0.0)])
@pytest.mark.parametrize("start", [-9.0, 3.0])
def test_sizes_are_as_likely_as_those_that_a_search_by_values_alone_finds(
    std: tuple[float, float], start: float
) -> None:
    """None of them included, and wherever it begins."""
    given = two_joints(3, std)
    found = given.largest(np.full(2, start))
    grid = np.linspace(-12.0, 10.0, 12)
    best = min(product(grid, grid), key=lambda at: given(np.array(at))[0])
    other = minimize(lambda x: given(x)[0], best, method="Nelder-Mead", options={"fatol": 1e-6})
    assert given(found)[0] < other.fun + 0.01


@pytest.mark.parametrize("correlation", [0.0, 0.5])
def test_the_correlation_of_noise_is_no_random_force(correlation: float) -> None:
    found = [
        d.evidence(fit) for fit, _, d in (disturbed(k, 0.0, 1.0, correlation) for k in range(3))
    ]
    told = np.mean([each.correlation[0] for each in found])
    assert told == pytest.approx(correlation, abs=0.08)
    assert max(float(each.std[0]) for each in found) < 0.5 * STD


@pytest.mark.parametrize(
    ("std", "noise"), [(STD, 1.0), (4.0 * STD, 1.0), (STD, 2.0), (STD, (1.0, 8.0))]
)
def test_the_sizes_that_made_the_data_are_recovered(
    std: float, noise: float | tuple[float, float]
) -> None:
    found = [d.evidence(fit) for fit, _, d in (disturbed(seed, std, noise) for seed in range(3))]
    assert np.mean([float(each.std[0]) for each in found]) == pytest.approx(std, rel=0.15)
    read = np.atleast_1d(noise)
    told = np.mean([each.noise[: len(read)] for each in found], axis=0)
    assert told == pytest.approx(read, rel=0.1)


def test_the_evidence_is_of_motions_near_the_measured_ones_wherever_a_fit_has_left_them() -> None:
    """A double pendulum's motion of a second is far from linear in where it begins."""
    known = problem(envs.PLANTS["mcpilco/DoublePendulum-v0"](), [])
    fit, windows = fit_nominal(known.model(known.windows()), known.windows())
    found = fit.by_window < windows.samples  # but where the motion is lost from the start
    fit, windows = fit.at(np.flatnonzero(found)), windows[found]
    moved = replace(fit, x0=fit.x0 + np.random.default_rng(0).normal(0.0, 0.02, fit.x0.shape))
    left = misfits(fit.model, windows, fit.theta, moved.x0)
    assert left.sum() > 100.0 * fit.by_window.sum()
    near, far = (Disturbance.of(each, windows).evidence(each) for each in (fit, moved))
    assert far.deviance == pytest.approx(near.deviance, abs=1.0)
    np.testing.assert_allclose(far.std, near.std, atol=1e-4)


def test_noise_far_below_the_reported_one_is_rounding_and_tells_nothing_of_a_model() -> None:
    fit, windows, _ = disturbed(2, 0.0)
    y = run(fit.model, windows, fit.theta[None], fit.x0[None])[0]
    ripples = [1.0 + size * np.sin(np.arange(windows.y.shape[2])) for size in (1e-7, 1e-6)]
    exact = [replace(windows, y=np.where(windows.measured, y * each, np.nan)) for each in ripples]
    better, worse = (Disturbance.of(fit, each).evidence(fit) for each in exact)
    assert better.noise.min() == worse.noise.min() == pytest.approx(DISTURBANCE.least_noise)
    assert worse.deviance == pytest.approx(better.deviance, abs=1.0)


def test_where_nothing_is_missing_no_force_is_left() -> None:
    fit, _, disturbance = disturbed(2, 0.0)
    assert disturbance.evidence(fit).std[0] < 0.2 * STD


def test_whitened_residuals_are_white() -> None:
    """Their mean square is that of the noise, with forces many times as strong."""
    fit, windows, disturbance = disturbed(3, 10.0 * STD)
    white = disturbance.whitened(disturbance.evidence(fit))
    refit = fitted(fit.model, white, fit.theta)
    assert misfits(fit.model, windows, fit.theta, fit.x0).sum() > 10.0 * windows.samples.sum()
    assert refit.by_window.sum() == pytest.approx(windows.samples.sum(), rel=0.15)


def test_whitening_is_the_inverse_root_of_the_covariance() -> None:
    fit, windows, disturbance = disturbed(4, STD, correlation=0.4)
    evidence = disturbance.evidence(fit)
    white = disturbance.whitened(evidence)
    std = evidence.std[disturbance.joint]
    noisy = noise_covariance(windows, evidence.noise, evidence.correlation)
    y = run(fit.model, windows, fit.theta[None], fit.x0[None])[0]
    plain, weighed = residual(windows, y), residual(white, y)
    for w in (0, len(windows) - 1):
        G: Float[np.ndarray, "n m"] = disturbance.columns[w] * std
        G = np.where(windows.measured[w].reshape(-1, 1), G, 0.0)
        seen = windows.measured[w].ravel()
        covariance = (noisy + G @ G.T)[np.ix_(seen, seen)]
        squares = plain[w][seen] @ np.linalg.solve(covariance, plain[w][seen])
        expected = squares * max(evidence.noise.min(), 1.0) ** 2
        assert np.square(weighed[w]).sum() == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("noise", "weights"),
    [
        ((0.5, 0.5), (2.0, 2.0)),
        ((3.0, 3.0), (1.0, 1.0)),
        ((1.0, 8.0), (1.0, 0.125)),
        ((3.0, 6.0), (1.0, 0.5)),
    ],
    ids=["less than reported", "more in all", "more in one", "more in all, and in one"],
)
def test_a_reading_weighs_by_its_noise_beside_the_others(
    noise: tuple[float, float], weights: tuple[float, float]
) -> None:
    fit, windows, disturbance = disturbed(4, STD)
    evidence = replace(disturbance.evidence(fit), noise=np.array(noise), correlation=np.zeros(2))
    white = disturbance.whitened(evidence)
    assert white.whitening is not None
    told = white.whitening.F.a.reshape(windows.y.shape)
    np.testing.assert_allclose(told, np.broadcast_to(np.array(weights)[:, None], told.shape))


def test_a_window_is_whitened_alike_among_others_and_alone() -> None:
    fit, _, disturbance = disturbed(5, STD)
    white = disturbance.whitened(disturbance.evidence(fit))
    y = run(fit.model, white, fit.theta[None], fit.x0[None])[0]
    some = np.array([3, 1])
    np.testing.assert_allclose(residual(white[some], y[some]), residual(white, y)[some])
    assert white.plain.whitening is None
    assert white.part(0, 5).whitening is None


def test_forces_are_held_as_long_as_the_thresholds_say() -> None:
    _, windows, disturbance = disturbed(6, STD)
    hold = round(FORCE.hold_s / windows.dt)
    assert disturbance.columns.shape[2] == -(-(windows.y.shape[2] - 1) // hold)


def test_each_joint_has_a_force_of_its_own(lagging: tuple[GapProblem, Windows, Fit]) -> None:
    known = problem(envs.PLANTS["mcpilco/CartPoleSwingUp-v0"](), [])
    windows = known.windows()
    model = known.model(windows)
    disturbance = Disturbance.of(fitted(model, windows, np.zeros(model.nuisances)), windows)
    assert list(np.unique(disturbance.joint)) == [0, 1]
