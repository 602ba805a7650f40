"""Moments of sines of a Gaussian."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from baselines.moments import gaussian_through_squash, gaussian_through_trig, through_sine
from tests.baselines.differences import slope_along

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


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize(("scale", "rank"), [(0.1, 3), (0.8, 3), (0.8, 1)])
def test_moments_agree_with_samples(name, scale, rank):
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
def test_gradients_are_those_of_central_differences(name, rank):
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
