"""Expected costs, against integrals and samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.stats import norm

from baselines.moments import Gaussian, expected_cost
from baselines.moments.costs import TipDistanceCost
from mcpilco.policies import QuadraticCost, SaturatingCost, TipCost, cart_pole_cost
from mcpilco.typing import InputError
from tests.baselines.differences import slope_along

EXACT = {
    "cart-pole": cart_pole_cost(),
    "plain": SaturatingCost((1, 3), (0.4, -1.0), (0.7, 2.0), (False, False)),
    "quadratic": QuadraticCost((0.0, 0.0, 1.0, 0.0), (1.0, 0.5, 2.0, 0.0), (0.3,)),
}
MATCHED = {
    "tip distance": TipDistanceCost(0, 2),
    "tip": TipCost((2,), (0.5,), 0.7, 0, 1.0),
    "two tips": TipCost((2, 3), (0.5, 0.3), 0.7),
}
COSTS = EXACT | MATCHED
MEAN = torch.tensor([0.3, 0.1, 2.0, 0.5], dtype=torch.float64)


def covariance(scale: float, rank: int = 4) -> torch.Tensor:
    root = scale * torch.from_numpy(np.random.default_rng(0).standard_normal((4, rank)))
    return root @ root.mT


def inputs(cov: torch.Tensor) -> Gaussian:
    """An input that is the first state."""
    return Gaussian(MEAN[:1], cov[:1, :1])


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize(("scale", "rank"), [(0.1, 4), (1.0, 4), (1.0, 1)])
def test_exact_expectations_agree_with_samples(name, scale, rank):
    cost, cov = COSTS[name], covariance(scale, rank)
    seen = np.random.default_rng(1).multivariate_normal(MEAN.numpy(), cov.numpy(), 400_000)
    states = torch.from_numpy(seen)
    values = cost(states, states[:, :1])
    expected = expected_cost(cost, Gaussian(MEAN, cov), inputs(cov))
    error = 4 * float(values.std()) / len(values) ** 0.5
    assert float(expected) == pytest.approx(float(values.mean()), abs=error)


@pytest.mark.parametrize("mean", [0.0, 0.5, -2.5])
@pytest.mark.parametrize("std", [0.05, 1.0, 5.0])
def test_the_cost_of_a_magnitude_is_its_integral(mean, std):
    cost = SaturatingCost((0,), (math.pi,), (1.0,), (True,))

    def density(x):
        return (1 - math.exp(-((abs(x) - math.pi) ** 2))) * norm.pdf(x, mean, std)

    whole = (mean - 12 * std, mean + 12 * std)
    places = [x for x in (-math.pi, 0.0, math.pi, mean) if whole[0] < x < whole[1]]
    integral, _ = quad(density, *whole, points=places, epsabs=1e-12, limit=500)
    state = Gaussian(torch.tensor([mean]).double(), torch.tensor([[std**2]]).double())
    assert float(expected_cost(cost, state, state)) == pytest.approx(integral, abs=1e-9)


@pytest.mark.parametrize("name", COSTS)
def test_a_certain_state_costs_what_it_costs(name):
    cost, nothing = COSTS[name], torch.zeros(4, 4, dtype=torch.float64)
    expected = expected_cost(cost, Gaussian(MEAN, nothing), inputs(nothing))
    assert float(expected) == pytest.approx(float(cost(MEAN, MEAN[:1])), abs=1e-12)


@pytest.mark.parametrize("name", MATCHED)
def test_matched_expectations_are_near_for_narrow_states(name):
    cost, cov = COSTS[name], covariance(0.1)
    seen = np.random.default_rng(2).multivariate_normal(MEAN.numpy(), cov.numpy(), 400_000)
    mean = float(cost(torch.from_numpy(seen)).mean())
    expected = expected_cost(cost, Gaussian(MEAN, cov), inputs(cov))
    assert float(expected) == pytest.approx(mean, rel=2e-3)


@pytest.mark.parametrize("name", COSTS)
@pytest.mark.parametrize("rank", [4, 1, 0])
def test_gradients_are_those_of_central_differences(name, rank):
    cost, rng = COSTS[name], np.random.default_rng(3)
    mean, cov = MEAN.clone().requires_grad_(), covariance(0.5, rank).requires_grad_()

    def value(mean, cov):
        return expected_cost(cost, Gaussian(mean, cov), Gaussian(mean[:1], cov[:1, :1]))

    found = torch.autograd.grad(value(mean, cov), (mean, cov))
    way = torch.from_numpy(rng.standard_normal((4, 4)))
    ways = torch.from_numpy(rng.standard_normal(4)), way + way.mT
    if rank == 0:
        ways = ways[0], 0 * ways[1]  # a step of a zero variance leads out of the variances
    slope = sum(float((g * w).sum()) for g, w in zip(found, ways, strict=True))
    expected = slope_along(lambda h: value(mean + h * ways[0], cov + h * ways[1]))
    assert slope == pytest.approx(expected, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("name", COSTS)
def test_a_batch_is_its_members(name):
    covs = torch.stack([covariance(0.1), covariance(0.6)])
    states = Gaussian(torch.stack([MEAN, -MEAN]), covs)
    used = Gaussian(states.mean[:, :1], covs[:, :1, :1])
    together = expected_cost(COSTS[name], states, used)
    for i in range(2):
        state, one = Gaussian(states.mean[i], covs[i]), Gaussian(used.mean[i], used.cov[i])
        alone = expected_cost(COSTS[name], state, one)
        assert float(together[i]) == pytest.approx(float(alone), abs=1e-14)


def test_the_tip_costs_nothing_only_where_it_is_up():
    cost = TipDistanceCost(0, 2)
    up, down = torch.tensor([0.0, 1.0, math.pi, 1.0]), torch.zeros(4)
    assert float(cost(up.double())) == pytest.approx(0.0, abs=1e-12)
    assert float(cost(down.double())) == pytest.approx(1 - math.exp(-0.5 * (1.0 / 0.25) ** 2))


@pytest.mark.parametrize(
    ("cost", "sentence"),
    [
        (lambda states, inputs: states[..., 0], "known for .*QuadraticCost.* got function"),
        (SaturatingCost((0, 2), (1.0, 1.0), (1.0, 1.0), (True, True)), "at most one component"),
    ],
)
def test_a_cost_of_unknown_expectation_is_refused_with_a_sentence(cost, sentence):
    state = Gaussian(MEAN, covariance(1.0))
    with pytest.raises(InputError, match=sentence):
        expected_cost(cost, state, inputs(state.cov))


@pytest.mark.parametrize("wrong", [{"length": 0.0}, {"width": -1.0}])
def test_a_tip_without_size_is_refused(wrong):
    with pytest.raises(InputError, match="must be positive"):
        TipDistanceCost(0, 2, **wrong)
