"""Costs of a batch are the costs of its seeds, whatever the cost makes of a batch."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from mcpilco.agent.lockstep.costs import CostBatch
from mcpilco.policies import QuadraticCost, SaturatingCost
from mcpilco.search import Problem, rollout
from tests.mcpilco.linear import LinearDynamics

S, T, P = 3, 5, 4


def refuses_a_batch(states: Tensor, inputs: Tensor) -> Tensor:
    time, particles, _ = states.shape
    return states.reshape(time, particles, -1).square().sum(-1)


def mixes_the_batch(states: Tensor, inputs: Tensor) -> Tensor:
    return (states - states.mean()).square().sum(-1)


def turns_the_batch(states: Tensor, inputs: Tensor) -> Tensor:
    return states.square().sum(-1).transpose(0, -2)[: len(states)]


GOOD = [
    SaturatingCost((0,), (1.0,), (1.0,), (False,)),
    QuadraticCost((0.0, 0.0), (1.0, 0.5), (0.1,)),
    lambda states, inputs: states.new_full(states.shape[:-1], math.nan),
]
BAD = [refuses_a_batch, mixes_the_batch, turns_the_batch]


def problem(cost) -> Problem:
    zero = torch.zeros(2, dtype=torch.float64)
    return Problem(LinearDynamics(), cost, zero, zero, T, 1.0, rollout)


def particles() -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    states = torch.randn(S, T + 1, P, 2, generator=generator, dtype=torch.float64)
    return states, torch.randn(S, T, P, 1, generator=generator, dtype=torch.float64)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("cost", GOOD + BAD)
def test_the_cost_of_each_seed_is_its_own(cost, caplog: pytest.LogCaptureFixture) -> None:
    states, inputs = particles()
    costs, problems = CostBatch(), [problem(cost)] * S
    for _ in range(2):
        found = costs(problems, states, inputs)
        for seed in range(S):
            torch.testing.assert_close(
                found[seed], cost(states[seed, 1:], inputs[seed]), equal_nan=True
            )
    assert caplog.text.count("called seed by seed") == (cost in BAD)


def test_a_cost_that_takes_a_batch_is_called_once() -> None:
    calls = []

    def counted(states: Tensor, inputs: Tensor) -> Tensor:
        calls.append(states.shape)
        return states.square().sum(-1)

    costs, problems = CostBatch(), [problem(counted)] * S
    costs(problems, *particles())
    calls.clear()
    costs(problems, *particles())
    assert calls == [(S, T, P, 2)]


def test_costs_of_seeds_that_differ_are_taken_seed_by_seed() -> None:
    problems = [problem(SaturatingCost((0,), (target,), (1.0,), (False,))) for target in (0.0, 1.0)]
    states, inputs = particles()
    found = CostBatch()(problems, states[:2], inputs[:2])
    for seed in range(2):
        alone = problems[seed].cost(states[seed, 1:], inputs[seed])
        torch.testing.assert_close(found[seed], alone)


def test_a_widened_cost_is_each_seeds_widened_cost() -> None:
    cost = GOOD[0]
    states, inputs = particles()
    found = CostBatch()([problem(cost)] * S, states, inputs, widening=3.0)
    torch.testing.assert_close(found, cost.widened(3.0)(states[:, 1:], inputs))
