"""L-BFGS on the expected cost, and what it does where there is none."""

from __future__ import annotations

import copy
import dataclasses
import functools
import math

import numpy as np
import pytest
import torch

from baselines.pilco.search import Problem, Starts, pilco_search
from mcpilco.policies import SaturatingCost
from tests.baselines.pilco.models import TINY, narrow_start, random_dynamics, random_policy

COST = SaturatingCost((1,), (1.0,), (1.0,), (False,))
CONFIG = dataclasses.replace(TINY, line_searches=10, evaluations=15)


def search(
    sometimes=lambda problem: problem, report=lambda *_: None, fresh=None, config=CONFIG, **starts
) -> functools.partial:
    dynamics = random_dynamics()
    policy = random_policy(dynamics)
    return functools.partial(
        pilco_search,
        config=config,
        problem=sometimes(Problem(dynamics, COST, narrow_start(), 4)),
        policy=policy,
        starts=Starts(fresh or (lambda: copy.deepcopy(policy)), **starts),
        generator=torch.Generator().manual_seed(0),
        report=report,
    )


def test_the_cost_falls_and_the_start_stays():
    told, asked = [], None
    asked = search(report=lambda step, most, values: told.append(values["policy/cost"]))
    before = copy.deepcopy(asked.keywords["policy"].state_dict())
    found = asked()
    assert found.best.cost == pytest.approx(min(told), abs=1e-12)
    assert found.best.cost < told[0] - 0.01
    assert len(told) == found.steps <= CONFIG.evaluations
    assert all(
        torch.equal(value, before[name])
        for name, value in asked.keywords["policy"].state_dict().items()
    )


def test_the_expected_cost_is_that_of_the_particles_shown():
    best = search()().best
    prediction = best.prediction(300)
    assert prediction.states.shape == (5, 300, 4)
    assert prediction.inputs.shape == (4, 300, 1)
    total = prediction.costs.sum(0)
    assert total.mean() == pytest.approx(best.cost, abs=4 * total.std() / 300**0.5)
    mean, cov = prediction.states[-1].mean(0), np.cov(prediction.states[-1].T)
    assert mean == pytest.approx(
        best.states.mean[-1].numpy(), abs=4 * cov.diagonal().max() ** 0.5 / 17
    )


def test_further_starts_begin_while_the_model_predicts_failure():
    one = search()()
    assert one.starts == 1
    assert search(further=2)().starts == 1, "failure is nothing that a cost of infinity exceeds"
    assert search(further=2, failing=one.best.final_cost + 1e-9)().starts == 1
    three = search(further=2, failing=0.0)()
    assert three.starts == 3
    assert three.steps == pytest.approx(3 * one.steps, abs=2 * CONFIG.evaluations)
    assert three.best.cost <= one.best.cost


def test_the_best_of_all_starts_is_found():
    better = search(config=dataclasses.replace(CONFIG, line_searches=60, evaluations=90))().best
    found = search(fresh=lambda: copy.deepcopy(better.policy), further=1, failing=0.0)().best
    assert found.cost <= better.cost + 1e-9
    assert found.cost < search()().best.cost


def test_a_further_start_without_an_answer_is_passed_over():
    one = search()()
    problem = Sometimes(one.steps + 2)  # after its steps and its prediction
    found = search(problem, further=1, failing=0.0)()
    assert found.starts == 2
    assert found.best.cost == one.best.cost


class Sometimes:
    """A problem that has no answer at the calls named."""

    def __init__(self, *failing: int, as_nan: bool = False) -> None:
        self.failing, self.as_nan, self.calls = failing, as_nan, 0

    def __call__(self, problem):
        self.problem, self.cost = problem, problem.cost
        return self

    def prediction(self, policy):
        self.calls += 1
        if self.calls not in self.failing:
            return self.problem.prediction(policy)
        if not self.as_nan:
            raise torch.linalg.LinAlgError
        states, inputs, costs = self.problem.prediction(policy)
        return states, inputs, costs * math.nan


@pytest.mark.parametrize("as_nan", [False, True])
def test_a_step_without_an_answer_is_shortened(as_nan):
    usual = search()()
    found = search(Sometimes(3, 4, as_nan=as_nan))()
    assert math.isfinite(found.best.cost)
    assert found.best.cost < search(Sometimes(), config=TINY)().best.cost + 0.5
    assert found.best.cost == pytest.approx(usual.best.cost, abs=0.3)


def test_a_start_without_an_answer_gives_way_to_a_random_one():
    found = search(Sometimes(1))()
    assert found.starts == 2
    assert math.isfinite(found.best.cost)


def test_where_nothing_has_an_answer_the_search_says_so():
    with pytest.raises(torch.linalg.LinAlgError, match="nothing finite"):
        search(Sometimes(1, 2))()
