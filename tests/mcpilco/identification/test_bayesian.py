"""Laws of the variational EM: its algebra, its bound, and what it cannot tell."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from mcpilco.identification import Moments, NoisyInputConfig, UnidentifiedWarning, fit_noisy_inputs
from mcpilco.identification.bayesian import b_noise, b_true, reliability
from mcpilco.identification.latent import Weights, expect
from mcpilco.typing import InputError

JFA = NoisyInputConfig(a0=None)


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


@pytest.mark.parametrize(
    "config", [NoisyInputConfig, lambda **more: NoisyInputConfig(a0=None, **more)]
)
def test_the_bound_never_falls(config):
    rng = np.random.default_rng(0)
    X, y, _ = noisy_inputs(rng, 300, 8, 2.0)
    X = np.hstack([X, X @ rng.dirichlet(np.ones(8), 6).T, rng.normal(size=(300, 6))])
    fit = fit_noisy_inputs(Moments.of(X, y), config(tolerance=0.0, max_iterations=500), warn=False)
    assert len(fit.bounds) == 500
    assert (np.diff(fit.bounds) >= -1e-9 * np.abs(fit.bounds[1:])).all()
    assert fit.bounds[-1] - fit.bounds[0] > 10.0
    assert not fit.converged


def test_the_bound_of_joint_factor_analysis_is_its_likelihood():
    """Where the posterior of z and t is exact, nothing is lost."""
    rng = np.random.default_rng(1)
    X, y, _ = noisy_inputs(rng, 200, 3, 5.0)
    fit = fit_noisy_inputs(Moments.of(X, y), NoisyInputConfig(a0=None, tolerance=1e-13), warn=False)
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
    fit = fit_noisy_inputs(moments, JFA, warn=False)
    assert fit.converged
    np.testing.assert_allclose(fit.b_noise, moments.least_squares(), atol=0.03)
    assert np.abs(fit.b_noise).max() > 6.0


def test_the_reliability_of_inputs_is_where_the_search_starts():
    """Nearly clean inputs, signal over noise 100: two starts, two answers, equal likelihoods."""
    moments = Moments.of(*noisy_inputs(np.random.default_rng(3), 20000, 10, 100.0)[:2])
    found = []
    for start in (0.3, 0.9):
        with pytest.warns(UnidentifiedWarning, match="is not told by the data"):
            found.append(fit_noisy_inputs(moments, NoisyInputConfig(a0=None, reliability=start)))
    low, high = found
    assert abs(low.b_true[0] - 1.0) > 0.2
    assert abs(low.b_true[0] - high.b_true[0]) > 0.3
    assert low.bounds[-1] == pytest.approx(high.bounds[-1], rel=1e-4)
    assert (reliability(low.weights) > low.least_reliability - 0.05).all()


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
    "values", [{"reliability": 0.0}, {"reliability": 1.0}, {"max_iterations": 0}]
)
def test_numbers_of_the_search_are_checked(values):
    with pytest.raises(InputError, match="must be"):
        NoisyInputConfig(**values)
