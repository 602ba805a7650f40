"""Moments of Gaussian processes and of sines at Gaussian inputs, against their definitions."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import torch
from mpmath import mp

from baselines.moments import (
    Bases,
    gaussian_through_gp,
    gaussian_through_squash,
    gaussian_through_trig,
    through_bases,
    through_sine,
)
from mcpilco.gp import GP
from mcpilco.kernels import RBF
from mcpilco.typing import InputError
from tests.baselines.differences import slope_along
from tests.baselines.moments.random_gps import Case, kernel, random_case


def bases_of(case: Case) -> Bases:
    """The posterior, by definition."""
    rows = zip(case.lengthscale, case.signal_std, case.noise_std, strict=True)
    inverse = np.stack(
        [
            np.linalg.inv(kernel(case.x, case.x, length, std) + noise**2 * np.eye(len(case.x)))
            for length, std, noise in rows
        ]
    )
    weights = np.einsum("enm,me->en", inverse, case.y)
    arrays = case.x, case.lengthscale, case.signal_std**2, weights, inverse
    return Bases(*map(torch.from_numpy, arrays))


# Truth --------------------------------------------------------------------------------------------


def worst_z(case: Case, rng: np.random.Generator, samples: int) -> float:
    """The largest distance of M, S and cov V from sample moments, in standard errors."""
    M, S, V = gaussian_through_gp(*case)
    bases = bases_of(case)
    seen = rng.multivariate_normal(case.mean, case.cov, samples)
    values = np.empty((samples, len(M)))
    for e in range(len(M)):
        k = kernel(seen, case.x, case.lengthscale[e], case.signal_std[e])
        explained = np.einsum("si,si->s", k @ bases.inverse[e].numpy(), k)
        std = np.sqrt(np.maximum(case.signal_std[e] ** 2 - explained, 0.0))
        values[:, e] = k @ bases.weights[e].numpy() + std * rng.standard_normal(samples)
    inputs, outputs = seen - case.mean, values - M
    told = [(values, M)]
    told += [(outputs * outputs[:, [e]], S[e]) for e in range(len(M))]
    told += [(outputs * inputs[:, [d]], (case.cov @ V)[d]) for d in range(len(case.mean))]
    error = [sample.mean(0) - expected for sample, expected in told]
    scale = [sample.std(0) / samples**0.5 for sample, _ in told]
    return float(np.abs(np.concatenate(error) / np.concatenate(scale)).max())


@pytest.mark.parametrize("seed", range(4))
def test_moments_agree_with_samples(seed):
    rng = np.random.default_rng(seed)
    assert worst_z(random_case(rng), rng, 100_000) < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(50))
def test_moments_agree_with_a_million_samples(seed):
    rng = np.random.default_rng((7, seed))
    assert worst_z(random_case(rng), rng, 1_000_000) < 4.0


def by_mpmath(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M, S and V in 40 digits, as the PILCO paper has them, with the inverse of the covariance."""
    x, y, mean, cov = (mp.matrix(a.tolist()) for a in (case.x, case.y, case.mean, case.cov))
    N, D, E = x.rows, x.cols, y.cols
    nu = [x[i, :].T - mean for i in range(N)]
    scale = [mp.diag([mp.mpf(v) ** 2 for v in row]) for row in case.lengthscale.tolist()]
    power = [mp.mpf(v) ** 2 for v in case.signal_std.tolist()]
    eye, M, V, S = mp.eye(D), mp.matrix(E, 1), mp.matrix(D, E), mp.matrix(E, E)
    beta, inverse = [], []

    def quadratic(v, A):
        return (v.T * A * v)[0]

    for e in range(E):
        W = scale[e] ** -1
        K = mp.matrix(N, N)
        for i in range(N):
            for j in range(N):
                K[i, j] = power[e] * mp.exp(-quadratic(nu[i] - nu[j], W) / 2)
            K[i, i] += mp.mpf(float(case.noise_std[e])) ** 2
        inverse.append(K**-1)
        beta.append(inverse[e] * y[:, e])
        narrow = power[e] / mp.sqrt(mp.det(cov * W + eye))
        for i in range(N):
            F = (cov + scale[e]) ** -1
            q = narrow * mp.exp(-quadratic(nu[i], F) / 2)
            M[e] += beta[e][i] * q
            V[:, e] += beta[e][i] * q * (F * nu[i])
    for a in range(E):
        for b in range(E):
            Wa, Wb = scale[a] ** -1, scale[b] ** -1
            R = cov * (Wa + Wb) + eye
            T = R**-1 * cov
            for i in range(N):
                for j in range(N):
                    z = Wa * nu[i] + Wb * nu[j]
                    exponent = quadratic(nu[i], Wa) + quadratic(nu[j], Wb) - quadratic(z, T)
                    Q = power[a] * power[b] / mp.sqrt(mp.det(R)) * mp.exp(-exponent / 2)
                    S[a, b] += beta[a][i] * beta[b][j] * Q
                    if a == b:
                        S[a, b] -= inverse[a][i, j] * Q
            S[a, b] += (power[a] if a == b else 0) - M[a] * M[b]
    return tuple(np.array(A.tolist(), dtype=float) for A in (M, S, V))


@pytest.mark.parametrize("rank", [3, 1])
def test_moments_agree_with_forty_digits(rank):
    case = random_case(np.random.default_rng(1), samples=5, rank=rank)
    with mpmath.workdps(40):
        M, S, V = by_mpmath(case)
    for found, expected in zip(gaussian_through_gp(*case), (M[:, 0], S, V), strict=True):
        assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("spread", [0.0, 1e-8])
def test_a_certain_input_gives_the_plain_posterior(spread):
    case = random_case(np.random.default_rng(2))
    posterior = plain_posterior(case)
    at = torch.from_numpy(case.mean)[None].requires_grad_()
    mean, variance = posterior.mean_and_variance(at)
    rows = [torch.autograd.grad(m, at, retain_graph=True)[0][0] for m in mean[0]]
    M, S, V = gaussian_through_gp(*case._replace(cov=spread**2 * np.eye(3)))
    assert pytest.approx(mean[0].detach().numpy(), abs=1e-10) == M
    assert pytest.approx(np.diag(variance[0].detach().numpy()), abs=1e-10) == S
    assert pytest.approx(torch.stack(rows, 1).numpy(), abs=1e-10) == V


def plain_posterior(case: Case):
    """The posterior as the agent's GPs have it."""
    kernel = RBF(
        3,
        (2,),
        lengthscale=torch.from_numpy(case.lengthscale),
        variance=torch.from_numpy(case.signal_std**2),
    )
    gp = GP(kernel, noise_std=torch.from_numpy(case.noise_std), noise_floor=0.0)
    return gp.condition(torch.from_numpy(case.x), torch.from_numpy(case.y))


def test_a_narrow_input_moves_the_outputs_along_their_slopes():
    """S - diag(variance) goes to V^T s V as s goes to 0, where plain sums would have lost it."""
    case = random_case(np.random.default_rng(3))
    bases = bases_of(case)
    known = Bases(bases.centres, bases.lengthscale, bases.variance, bases.weights)
    cov = 1e-12 * torch.from_numpy(case.cov)
    image = through_bases(known, torch.from_numpy(case.mean), cov)
    linear = image.slope.mT @ cov @ image.slope
    assert torch.allclose(image.cov, linear, rtol=1e-3, atol=0.0)


def test_a_wide_input_finds_the_prior():
    case = random_case(np.random.default_rng(4))
    M, S, _ = gaussian_through_gp(*case._replace(cov=1e12 * np.eye(3)))
    assert pytest.approx(0.0, abs=1e-6) == M
    assert pytest.approx(np.diag(case.signal_std**2), abs=1e-6) == S


# Laws ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_the_joint_covariance_of_input_and_output_has_no_negative_eigenvalue(seed):
    case = random_case(np.random.default_rng(seed), rank=2)
    _, S, V = gaussian_through_gp(*case)
    cross = case.cov @ V
    joint = np.block([[case.cov, cross], [cross.T, S]])
    assert joint == pytest.approx(joint.T, abs=1e-14)
    assert np.linalg.eigvalsh(joint).min() > -1e-12


def test_a_batch_is_its_members():
    cases = [random_case(np.random.default_rng(seed)) for seed in range(3)]
    parts = [bases_of(case) for case in cases]
    names = ("centres", "lengthscale", "variance", "weights", "inverse")
    together = Bases(*(torch.stack([getattr(part, name) for part in parts]) for name in names))
    mean = torch.from_numpy(np.stack([case.mean for case in cases]))
    cov = torch.from_numpy(np.stack([case.cov for case in cases]))
    batch = through_bases(together, mean, cov)
    for i, case in enumerate(cases):
        single = gaussian_through_gp(*case)
        for found, expected in zip((batch.mean, batch.cov, batch.slope), single, strict=True):
            assert found[i].numpy() == pytest.approx(expected, abs=1e-10)


def test_a_batch_of_inputs_shares_the_functions():
    case = random_case(np.random.default_rng(5))
    means, covs = np.stack([case.mean, case.mean + 0.3]), np.stack([case.cov, 0 * case.cov])
    together = gaussian_through_gp(*case._replace(mean=means, cov=covs))
    for i in range(2):
        single = gaussian_through_gp(*case._replace(mean=means[i], cov=covs[i]))
        for found, expected in zip(together, single, strict=True):
            assert found[i] == pytest.approx(expected, abs=1e-13)


def test_moving_samples_and_input_together_changes_nothing():
    case = random_case(np.random.default_rng(6))
    moved = case._replace(x=case.x + 3.0, mean=case.mean + 3.0)
    pairs = zip(gaussian_through_gp(*case), gaussian_through_gp(*moved), strict=True)
    for here, there in pairs:
        assert here == pytest.approx(there, abs=1e-10)


# Gradients ----------------------------------------------------------------------------------------


def weighed(case: Case, weights: list[torch.Tensor], **replaced: torch.Tensor) -> torch.Tensor:
    """A scalar of all of M, S and V."""
    arguments = {name: torch.from_numpy(value) for name, value in case._asdict().items()}
    moments = gaussian_through_gp(**{**arguments, **replaced})
    return sum((part * w).sum() for part, w in zip(moments, weights, strict=True))


@pytest.mark.parametrize("rank", [3, 1, 0])
@pytest.mark.parametrize("name", ["mean", "cov", "x", "y", "lengthscale", "signal_std"])
def test_gradients_are_those_of_central_differences(name, rank):
    rng = np.random.default_rng(8)
    case = random_case(rng, samples=6, rank=rank)
    weights = [torch.from_numpy(rng.standard_normal(shape)) for shape in ((2,), (2, 2), (3, 2))]
    start = torch.from_numpy(getattr(case, name)).requires_grad_()
    (gradient,) = torch.autograd.grad(weighed(case, weights, **{name: start}), start)
    direction = torch.from_numpy(rng.standard_normal(start.shape))
    if name == "cov":
        direction = direction + direction.mT
    expected = slope_along(lambda h: weighed(case, weights, **{name: start + h * direction}))
    slope = float((gradient * direction).sum())
    assert slope == pytest.approx(expected, rel=1e-7, abs=1e-7)


def test_what_is_no_covariance_is_refused():
    bases = bases_of(random_case(np.random.default_rng(10)))
    with pytest.raises(torch.linalg.LinAlgError):
        through_bases(bases, torch.zeros(3).double(), -1e3 * torch.eye(3).double())


MEAN = np.array([0.4, -1.3, 2.9])


def covariance(scale: float, rank: int = 3) -> np.ndarray:
    root = scale * np.random.default_rng(0).standard_normal((3, rank))
    return root @ root.T


def squash(a, limit):
    return limit * (9 * np.sin(a) + np.sin(3 * a)) / 8


def trig(x):
    return np.stack(
        [np.sin(x[..., 2]), np.cos(x[..., 2]), np.sin(x[..., 0]), np.cos(x[..., 0])], -1
    )


FUNCTIONS = {
    "trig": (trig, lambda mean, cov: gaussian_through_trig(mean, cov, [2, 0])),
    "squash": (
        lambda x: squash(x, np.array([1.0, 10.0, 0.5])),
        lambda mean, cov: gaussian_through_squash(mean, cov, np.array([1.0, 10.0, 0.5])),
    ),
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize(("scale", "rank"), [(0.1, 3), (0.8, 3), (0.8, 1)])
def test_moments_of_sines_agree_with_samples(name, scale, rank):
    function, through = FUNCTIONS[name]
    rng, cov = np.random.default_rng(1), covariance(scale, rank)
    M, S, V = through(MEAN, cov)
    seen = rng.multivariate_normal(MEAN, cov, 400_000)
    values = function(seen)
    inputs, outputs = seen - MEAN, values - M
    told = [(values, M)]
    told += [(outputs * outputs[:, [e]], S[e]) for e in range(len(M))]
    told += [(outputs * inputs[:, [d]], (cov @ V)[d]) for d in range(3)]
    for sample, expected in told:
        error = 4 * sample.std(0) / len(sample) ** 0.5
        assert (np.abs(sample.mean(0) - expected) < error).all()


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_certain_input_gives_the_function_and_its_slope(name):
    function, through = FUNCTIONS[name]
    M, S, V = through(MEAN, np.zeros((3, 3)))
    assert pytest.approx(function(MEAN), abs=1e-14) == M
    assert pytest.approx(0.0, abs=0.0) == S
    h = 1e-6
    for d, step in enumerate(h * np.eye(3)):
        slope = (function(MEAN + step) - function(MEAN - step)) / (2 * h)
        assert V[d] == pytest.approx(slope, abs=1e-8)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_narrow_input_moves_along_the_slope(name):
    cov = covariance(1e-6)
    _, S, V = FUNCTIONS[name][1](MEAN, cov)
    assert pytest.approx(V.T @ cov @ V, rel=1e-6, abs=1e-22) == S


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("rank", [3, 1, 0])
def test_gradients_of_sines_are_those_of_central_differences(name, rank):
    rng = np.random.default_rng(2)
    mean, cov = torch.from_numpy(MEAN), torch.from_numpy(covariance(0.7, rank))
    through = FUNCTIONS[name][1]
    weights = [torch.from_numpy(rng.standard_normal(p.shape)) for p in through(mean, cov)]

    def total(mean, cov):
        return sum((p * w).sum() for p, w in zip(through(mean, cov), weights, strict=True))

    found = torch.autograd.grad(total(mean.requires_grad_(), cov.requires_grad_()), (mean, cov))
    way = torch.from_numpy(rng.standard_normal((3, 3)))
    ways = torch.from_numpy(rng.standard_normal(3)), way + way.mT
    slope = sum(float((g * w).sum()) for g, w in zip(found, ways, strict=True))
    expected = slope_along(lambda h: total(mean + h * ways[0], cov + h * ways[1]))
    assert slope == pytest.approx(expected, rel=1e-7, abs=1e-7)


def test_whatever_is_squashed_stays_within_the_limit():
    rng = np.random.default_rng(3)
    for scale in (0.1, 1.0, 10.0):
        M, S, _ = gaussian_through_squash(5 * rng.standard_normal(3), covariance(scale), 2.0)
        second = S + np.outer(M, M)
        assert (np.diag(second) <= 4.0 + 1e-12).all()


def test_a_wide_input_overflows_nowhere():
    M, S, V = gaussian_through_squash(MEAN, 1e4 * np.ones((3, 3)), 1.0)
    assert np.isfinite(S).all()
    assert pytest.approx(0.0, abs=1e-12) == M
    assert pytest.approx(0.0, abs=1e-12) == V
    # each wave's mean square is 1/2
    assert np.diag(S) == pytest.approx((9**2 + 1) / 64 / 2)


def test_sines_and_cosines_of_one_angle_lie_on_the_circle():
    M, S, _ = gaussian_through_trig(MEAN, covariance(0.9), [1])
    assert np.trace(S) + M @ M == pytest.approx(1.0, abs=1e-12)


def test_a_cosine_is_a_sine_a_quarter_turn_on():
    cov = torch.from_numpy(covariance(0.5))
    ahead = through_sine(torch.from_numpy(MEAN) + math.pi / 2, cov)
    M, S, _ = gaussian_through_trig(MEAN, cov.numpy(), [0, 1, 2])
    assert ahead.mean.numpy() == pytest.approx(M[1::2], abs=1e-15)
    assert ahead.cov.numpy() == pytest.approx(S[1::2, 1::2], abs=1e-15)


CASE = random_case(np.random.default_rng(0))._asdict()


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"y": np.zeros((9, 2))}, r"y must have shape \(10, 2\) as the samples say"),
        ({"lengthscale": np.ones((2, 2))}, r"lengthscale must have shape \(2, 3\)"),
        ({"noise_std": np.zeros(2)}, "noise_std must be positive"),
        ({"mean": np.zeros(4)}, "mean and cov must have shapes"),
        ({"cov": np.full((3, 3), np.nan)}, "cov must be finite"),
        ({"x": "text"}, "x must be an array of numbers"),
        ({"x": np.zeros(3)}, "x must have 2 axes"),
    ],
)
def test_arguments_that_do_not_fit_are_named(wrong, sentence):
    with pytest.raises(InputError, match=sentence):
        gaussian_through_gp(**(CASE | wrong))


@pytest.mark.usefixtures("unchecked_shapes")
def test_an_angle_that_is_not_there_is_named():
    with pytest.raises(InputError, match=r"within 0\.\.1, got \[2\]"):
        gaussian_through_trig(np.zeros(2), np.eye(2), [2])


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_limit_of_another_width_is_named():
    with pytest.raises(InputError, match="limit must be one number or 2"):
        gaussian_through_squash(np.zeros(2), np.eye(2), np.ones(3))


def test_arrays_give_arrays_and_tensors_tensors():
    for kind, convert in ((np.ndarray, np.asarray), (torch.Tensor, torch.from_numpy)):
        found = gaussian_through_gp(**{name: convert(value) for name, value in CASE.items()})
        assert all(isinstance(part, kind) for part in found)
