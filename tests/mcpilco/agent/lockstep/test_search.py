"""Searches that run together find what each finds alone."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import pytest
import torch
from torch import Tensor

from mcpilco.agent.learning import SearchRequest
from mcpilco.agent.lockstep import search_together
from mcpilco.config import Phase, SearchConfig
from mcpilco.search import PolicySearch, Problem, rollout, schedule
from mcpilco.search.search import MOST_SKIPPED
from mcpilco.task import TaskSpec
from mcpilco.typing import Cost, InputError
from tests.mcpilco.conftest import make_dynamics, make_policy

T = 6
SEEDS = range(4)
PLAIN = SearchConfig(particles=9, steps=(8,), restarts=(0,), evaluation_particles=11)

Steps = list[dict[str, float]]


@pytest.fixture(autouse=True)
def hasty_monitor(monkeypatch: pytest.MonkeyPatch) -> None:
    """The monitor's averages fill in some steps, not in hundreds."""
    hasty = functools.partial(schedule.DriftMonitor, decay=0.5, window=5)
    monkeypatch.setattr(schedule, "DriftMonitor", hasty)


def request(task: TaskSpec, seed: int, config: SearchConfig, cost: Cost | None = None):
    """A search of a seed with its own model, and what it reports."""
    steps: Steps = []
    generator = torch.Generator().manual_seed(seed)
    problem = Problem(
        dynamics=make_dynamics(task, samples=12 + seed, seed=seed),
        cost=task.cost if cost is None else cost,
        start_mean=torch.tensor(task.start_mean, dtype=torch.float64),
        start_std=torch.tensor(task.start_std, dtype=torch.float64),
        horizon=T,
        reference_cost=1.0,
        rollout=rollout,
    )

    def fresh():
        policy = make_policy(task, bases=7)
        span = torch.ones(3, dtype=torch.float64)
        policy.randomise(span, span, 1.0, 5.0, generator)
        return policy

    search = PolicySearch(config, generator, lambda step, most, values: steps.append(values))
    return SearchRequest(search, problem, make_policy(task, bases=7, seed=seed), fresh, 1), steps


def assert_same(found, expected, tolerance: float) -> None:
    assert (found.starts, found.steps) == (expected.starts, expected.steps)
    assert found.best.cost == pytest.approx(expected.best.cost, rel=tolerance, nan_ok=True)
    for mine, its in zip(
        found.best.policy.parameters(), expected.best.policy.parameters(), strict=True
    ):
        torch.testing.assert_close(mine, its, rtol=tolerance, atol=tolerance)


def both(
    task: TaskSpec, config: SearchConfig, costs: Callable[[int], Cost | None] = lambda seed: None
) -> list[tuple[Any, Any, Steps, Steps]]:
    """Each seed's result and steps, together and alone."""
    together = [request(task, seed, config, costs(seed)) for seed in SEEDS]
    found = search_together([asked for asked, _ in together])
    alone = [request(task, seed, config, costs(seed)) for seed in SEEDS]
    expected = [asked.answer() for asked, _ in alone]
    reports = [(mine, its) for (_, mine), (_, its) in zip(together, alone, strict=True)]
    return [(f, e, *r) for f, e, r in zip(found, expected, reports, strict=True)]


CONFIGS = {
    "as by default": PLAIN,
    "some half-way": dataclasses.replace(PLAIN, failing=0.99),
    "with restarts": dataclasses.replace(PLAIN, restarts=(2,), failing=0.95, steps=(5,)),
    "with dropout": dataclasses.replace(
        PLAIN, phases=(Phase(0.05, 0.25, until=0.5), Phase(0.02)), clip_norm=None
    ),
    "monitored": dataclasses.replace(
        PLAIN,
        monitored=True,
        widening=1.0,
        steps=(30,),
        phases=(Phase(1e-3, 0.25, drift=0.3), Phase(1e-4, drift=0.3)),
    ),
}


@pytest.mark.parametrize("name", CONFIGS)
def test_each_seed_goes_as_if_alone(task: TaskSpec, name: str) -> None:
    for found, expected, mine, its in both(task, CONFIGS[name]):
        assert len(mine) == len(its) == found.steps
        for step, values in zip(mine[:8], its[:8], strict=True):
            assert step == pytest.approx(values, rel=1e-8)
        assert_same(found, expected, 1e-5)


def test_only_seeds_whose_models_predict_failure_start_again(task: TaskSpec) -> None:
    starts = [found.starts for found, *_ in both(task, CONFIGS["with restarts"])]
    assert len(set(starts)) > 1


def test_seeds_of_a_monitored_schedule_end_when_their_own_cost_has_settled(task: TaskSpec) -> None:
    steps = [found.steps for found, *_ in both(task, CONFIGS["monitored"])]
    assert len(set(steps)) > 2
    assert max(steps) == 30


def test_a_seed_whose_costs_are_not_finite_is_given_up_and_the_others_go_on(task: TaskSpec) -> None:
    def costs(seed: int) -> Cost:
        def cost(states: Tensor, inputs: Tensor) -> Tensor:
            return task.cost(states, inputs) * (math.nan if seed == 1 else 1.0)

        return cost

    config = dataclasses.replace(PLAIN, steps=(MOST_SKIPPED + 5,))
    for seed, (found, expected, _, _) in enumerate(both(task, config, costs)):
        assert found.steps == MOST_SKIPPED + 5 * (seed != 1)
        assert_same(found, expected, 1e-5)


def test_a_result_does_not_depend_on_the_batch(task: TaskSpec) -> None:
    few, many = (
        search_together([request(task, seed, PLAIN)[0] for seed in range(count)])
        for count in (2, 4)
    )
    for mine, its in zip(few, many, strict=False):
        assert_same(mine, its, 1e-9)


def test_single_precision_finds_nearly_the_same(task: TaskSpec) -> None:
    rough, exact = (
        search_together([request(task, seed, PLAIN)[0] for seed in SEEDS], dtype=dtype)
        for dtype in (torch.float32, torch.float64)
    )
    for mine, its in zip(rough, exact, strict=True):
        assert mine.best.cost == pytest.approx(its.best.cost, rel=1e-2)
        assert mine.best.costs.dtype == torch.float64


def test_the_time_of_a_batch_is_shared(task: TaskSpec) -> None:
    found = search_together([request(task, seed, PLAIN)[0] for seed in SEEDS])
    (spent,) = {result.spent for result in found}
    assert spent.cpu_s > 0


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_search_of_another_algorithm_is_refused() -> None:
    class OtherRequest:
        pass

    with pytest.raises(InputError, match="Searches of MC-PILCO run together, got OtherRequest"):
        search_together([OtherRequest()])  # type: ignore[list-item]


def test_what_does_not_belong_together_is_refused(task: TaskSpec) -> None:
    one = request(task, 0, PLAIN)[0]
    with pytest.raises(InputError, match="one configuration, trial and horizon, got 2 kinds"):
        search_together([one, dataclasses.replace(one, trial=2)])
    with pytest.raises(InputError, match="run them one by one"):
        search_together([dataclasses.replace(one, policy=torch.nn.Linear(4, 1))])
