"""Laws of the variational EM: its algebra, its bound, and what it cannot tell."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from mcpilco.identification import (
    Moments,
    NoisyInputConfig,
    UnidentifiedWarning,
    fit_noisy_inputs,
    middle_reliability,
)
from mcpilco.identification.noisy_inputs.bayesian import _start, b_noise, b_true, reliability
from mcpilco.identification.noisy_inputs.em import _EM, Point, Weights, expect
from mcpilco.typing import InputError


def jfa(start: float = 0.5, **more) -> NoisyInputConfig:
    return NoisyInputConfig(starts=(start,), reliability="search", a0=None, **more)


def random_weights(rng: np.random.Generator, D: int) -> Weights:
    return Weights(
        w_z=rng.normal(size=D),
        w_x=rng.choice([-1.0, 1.0], D) * rng.uniform(0.5, 1.5, D),
        var_z=rng.uniform(0.01, 0.5, D),
        var_x=rng.uniform(0.01, 0.5, D),
        psi_z=rng.uniform(0.1, 2.0, D),
        psi_x=rng.uniform(0.1, 2.0, D),
        psi_y=float(rng.uniform(0.1, 2.0)),
    )


def noisy_inputs(rng, N: int, D: int, snr: float):
    """X and y of b = 1 .. D; variances of 1, and of noise 1 / snr of the inputs, 1 / 5 of y."""
    b = np.arange(1.0, D + 1.0)
    T = rng.normal(size=(N, D))
    y = T @ b + rng.normal(size=N) * np.sqrt(b @ b / 5.0)
    return T + rng.normal(size=(N, D)) / np.sqrt(snr), y, b


def redundant_inputs(seed: int) -> Moments:
    """Ten inputs of signal over noise 5 and ninety convex combinations of them."""
    rng = np.random.default_rng(seed)
    X, y, _ = noisy_inputs(rng, 1000, 10, 5.0)
    return Moments.of(np.hstack([X, X @ rng.dirichlet(np.ones(10), 90).T]), y)


def plain_em(moments: Moments, config: NoisyInputConfig, iterations: int) -> np.ndarray:
    """The bounds of EM without leaps."""
    em, D = _EM(moments, config.a0, config.b0), len(moments.xy)
    at = Point(_start(moments, config.starts[0]), np.full(D, 0.0 if config.a0 is None else 1.0))
    bounds = []
    for _ in range(iterations):
        at = em(at)
        bounds.append(at.bound)
    return np.array(bounds)


@pytest.mark.parametrize("D", [1, 3, 12])
def test_the_e_step_is_that_of_a_dense_inverse(D):
    rng = np.random.default_rng(D)
    w, X, y = random_weights(rng, D), rng.normal(size=(30, D)), rng.normal(size=30)
    P = np.zeros((2 * D, 2 * D))
    P[:D, :D] = 1.0 / w.psi_y + np.diag(1.0 / w.psi_z)
    P[:D, D:] = P[D:, :D] = np.diag(-w.w_z / w.psi_z)
    P[D:, D:] = np.diag(1.0 + (w.w_x**2 + w.var_x) / w.psi_x + (w.w_z**2 + w.var_z) / w.psi_z)
    covariance = np.linalg.inv(P)
    h = np.hstack([np.repeat(y[:, None] / w.psi_y, D, 1), X * w.w_x / w.psi_x])
    mean = h @ covariance
    z, t = mean[:, :D], mean[:, D:]
    zz = covariance[:D, :D] + z.T @ z / 30
    zt = covariance[:D, D:] + z.T @ t / 30
    tt = covariance[D:, D:] + t.T @ t / 30
    found = expect(Moments.of(X, y), w)
    expected = {
        "zz": np.diag(zz),
        "zt": np.diag(zt),
        "tt": np.diag(tt),
        "xt": (X * t).mean(0),
        "yz": (y * z.sum(1)).mean(),
        "total": zz.sum(),
        "log_det": np.linalg.slogdet(covariance)[1],
    }
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=1e-12, atol=1e-12)


def test_the_printed_sign_of_the_appendix_is_not_that_of_the_inverse():
    w = random_weights(np.random.default_rng(0), 3)
    K = 1.0 + (w.w_x**2 + w.var_x) / w.psi_x + (w.w_z**2 + w.var_z) / w.psi_z
    P = np.block(
        [
            [1.0 / w.psi_y + np.diag(1.0 / w.psi_z), np.diag(-w.w_z / w.psi_z)],
            [np.diag(-w.w_z / w.psi_z), np.diag(K)],
        ]
    )
    covariance = np.linalg.inv(P)
    printed = -covariance[:3, :3] * (w.w_z / w.psi_z / K)
    np.testing.assert_allclose(covariance[:3, 3:], -printed, atol=1e-12)


def test_equations_3_and_4_as_printed_are_the_closed_forms():
    for seed in range(20):
        w = random_weights(np.random.default_rng(seed), 6)
        one, psi_z, psi_x = np.ones(6), np.diag(1 / w.psi_z), np.diag(1 / w.psi_x)
        W_z, W_x = np.diag(w.w_z), np.diag(w.w_x)
        A = np.eye(6) + np.diag(w.w_x**2 + w.var_x) @ psi_x + np.diag(w.w_z**2 + w.var_z) @ psi_z
        B = np.ones((6, 6)) / w.psi_y + psi_z - psi_z @ W_z.T @ np.linalg.inv(A) @ W_z @ psi_z
        C = np.ones((6, 6)) / w.psi_y + psi_z
        for matrix, tail, closed in (
            (B, psi_z @ W_z @ np.linalg.inv(A) @ W_x.T @ psi_x, b_noise(w)),
            (C, psi_z @ W_z.T @ np.linalg.inv(W_x), b_true(w)),
        ):
            row = one @ np.linalg.inv(matrix)
            printed = w.psi_y * row / (w.psi_y - row @ one) @ tail
            np.testing.assert_allclose(printed, closed, rtol=1e-10)


@pytest.mark.parametrize("config", [NoisyInputConfig(), jfa()])
def test_the_bound_never_falls(config):
    rng = np.random.default_rng(0)
    X, y, _ = noisy_inputs(rng, 300, 8, 2.0)
    X = np.hstack([X, X @ rng.dirichlet(np.ones(8), 6).T, rng.normal(size=(300, 6))])
    plain = plain_em(Moments.of(X, y), config, iterations=500)
    leaping = fit_noisy_inputs(Moments.of(X, y), config, warn=False).bounds
    for bounds in (plain, leaping):
        assert (np.diff(bounds) >= -1e-9 * np.abs(bounds[1:])).all()
        assert bounds[-1] - bounds[0] > 10.0
    assert len(plain) == 500


def test_a_search_that_is_cut_short_says_so():
    moments = Moments.of(*noisy_inputs(np.random.default_rng(9), 300, 8, 2.0)[:2])
    assert not fit_noisy_inputs(moments, NoisyInputConfig(max_iterations=30), warn=False).converged
    assert fit_noisy_inputs(moments, warn=False).converged


def test_the_bound_of_joint_factor_analysis_is_its_likelihood():
    """Where the posterior of z and t is exact, nothing is lost."""
    rng = np.random.default_rng(1)
    X, y, _ = noisy_inputs(rng, 200, 3, 5.0)
    fit = fit_noisy_inputs(Moments.of(X, y), jfa(tolerance=1e-13), warn=False)
    w = fit.weights
    covariance = np.zeros((4, 4))
    covariance[0, 0] = (w.w_z**2 + w.psi_z).sum() + w.psi_y
    covariance[0, 1:] = covariance[1:, 0] = w.w_z * w.w_x
    covariance[1:, 1:] = np.diag(w.w_x**2 + w.psi_x)
    rows = np.column_stack([y, X])
    quadratic = np.einsum("ni,ij,nj->", rows, np.linalg.inv(covariance), rows)
    log_det = np.linalg.slogdet(2.0 * np.pi * covariance)[1]
    assert fit.bounds[-1] == pytest.approx(-0.5 * (200 * log_det + quadratic), rel=1e-6)


def test_to_predict_from_noisy_inputs_joint_factor_analysis_is_least_squares():
    moments = Moments.of(*noisy_inputs(np.random.default_rng(2), 20000, 10, 2.0)[:2])
    fit = fit_noisy_inputs(moments, jfa(), warn=False)
    assert fit.converged
    np.testing.assert_allclose(fit.b_noise, moments.least_squares(), atol=0.03)
    assert np.abs(fit.b_noise).max() > 6.0


def test_the_reliability_of_inputs_is_where_the_search_starts():
    """Nearly clean inputs, signal over noise 100: two starts, two answers, equal likelihoods."""
    moments = Moments.of(*noisy_inputs(np.random.default_rng(3), 20000, 10, 100.0)[:2])
    found = []
    for start in (0.3, 0.9):
        with pytest.warns(UnidentifiedWarning, match="is not determined by the data"):
            found.append(fit_noisy_inputs(moments, jfa(start)))
    low, high = found
    assert abs(low.b_true[0] - 1.0) > 0.2
    assert abs(low.b_true[0] - high.b_true[0]) > 0.3
    assert low.bounds[-1] == pytest.approx(high.bounds[-1], rel=1e-4)
    assert (reliability(low.weights) > low.least_reliability - 0.05).all()


@pytest.mark.slow
def test_leaps_arrive_where_plain_iterations_creep():
    """A hundred inputs, nine of ten redundant."""
    moments, config = redundant_inputs(0), NoisyInputConfig(starts=(0.5,))
    fit = fit_noisy_inputs(moments, config, warn=False)
    plain = plain_em(moments, config, 3000)
    assert fit.converged
    assert len(fit.bounds) < 1500
    assert fit.bounds[-1] > plain[-1] + 5.0


@pytest.mark.slow
def test_of_several_starts_the_greatest_bound_is_taken():
    moments = Moments.of(*noisy_inputs(np.random.default_rng(1), 300, 12, 1.0)[:2])
    one_by_one = [
        fit_noisy_inputs(moments, NoisyInputConfig(starts=(start,)), warn=False)
        for start in (0.3, 0.9)
    ]
    both = fit_noisy_inputs(moments, NoisyInputConfig(starts=(0.3, 0.9)), warn=False)
    bounds = [fit.bounds[-1] for fit in one_by_one]
    assert bounds[0] != bounds[1]
    assert both.bounds[-1] == max(bounds)
    np.testing.assert_array_equal(both.b_true, one_by_one[int(np.argmax(bounds))].b_true)


@pytest.mark.parametrize("snr", [2.0, 5.0, 100.0])
def test_the_middle_of_what_the_data_allow_is_nearer_to_the_truth_than_its_ends(snr):
    """b of least squares is shrunk by r; R^2 <= r <= 1 is all that is told of it."""
    X, y, b = noisy_inputs(np.random.default_rng(7), 20000, 10, snr)
    moments = Moments.of(X, y)
    shrunk = moments.least_squares()
    R2 = 1.0 - moments.residual_variance(shrunk) * moments.N / moments.yy
    r = snr / (snr + 1.0)
    assert R2 < r < 1.0
    assert middle_reliability(moments, shrunk) == pytest.approx((1.0 + R2) / 2.0)

    def off(reliability: float) -> float:
        return float(np.linalg.norm(shrunk / reliability - b))

    assert off(middle_reliability(moments, shrunk)) < max(off(1.0), off(R2))
    fit = fit_noisy_inputs(moments, warn=False)
    assert np.linalg.norm(fit.b_true - b) < 0.15 * np.linalg.norm(b)


def test_a_given_reliability_is_taken():
    moments = Moments.of(*noisy_inputs(np.random.default_rng(8), 20000, 10, 2.0)[:2])
    fit = fit_noisy_inputs(moments, NoisyInputConfig(reliability=2.0 / 3.0), warn=False)
    np.testing.assert_allclose(fit.b_true, np.arange(1.0, 11.0), atol=0.25)
    np.testing.assert_allclose(fit.b_true, 1.5 * fit.b_noise)


def test_without_noise_in_the_output_there_is_nothing_to_warn_of():
    rng = np.random.default_rng(4)
    X = rng.normal(size=(500, 3))
    moments = Moments.of(X, X @ np.array([1.0, -2.0, 3.0]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fit = fit_noisy_inputs(moments)
    assert (fit.least_reliability > 0.95).all()


def test_inputs_that_do_not_matter_are_pruned():
    rng = np.random.default_rng(5)
    X, y, _ = noisy_inputs(rng, 2000, 4, 5.0)
    X = np.hstack([X, rng.normal(size=(2000, 8))])
    fit = fit_noisy_inputs(Moments.of(X, y), warn=False)
    assert fit.active[1:4].all()
    assert fit.active[4:].sum() <= 1
    assert (fit.b_true[~fit.active] == 0.0).all()


def test_moments_of_parts_are_those_of_the_whole():
    """So the time of an iteration does not depend on the number of samples, and data may stream."""
    X, y, _ = noisy_inputs(np.random.default_rng(6), 100, 4, 5.0)
    parts, whole = Moments.of(X[:30], y[:30]) + Moments.of(X[30:], y[30:]), Moments.of(X, y)
    assert parts.N == whole.N
    np.testing.assert_allclose(parts.xx, whole.xx)
    few = NoisyInputConfig(max_iterations=50)
    fits = [fit_noisy_inputs(moments, few, warn=False) for moments in (parts, whole)]
    np.testing.assert_allclose(fits[0].b_true, fits[1].b_true, rtol=1e-6)


@pytest.mark.parametrize(
    "values",
    [
        {"reliability": 0.0},
        {"reliability": 1.1},
        {"reliability": "start"},
        {"starts": ()},
        {"starts": (0.5, 1.0)},
        {"max_iterations": 0},
    ],
)
def test_numbers_of_the_search_are_checked(values):
    with pytest.raises(InputError, match="must be"):
        NoisyInputConfig(**values)
