"""Searches that follow a policy from an easier model to the model itself."""

from __future__ import annotations

import dataclasses
import functools
import itertools

import pytest
import torch

import envs  # noqa: F401  registers its ids
import mcpilco.search.search
from mcpilco.agent import MCPILCO
from mcpilco.config import Config, ModelConfig, SearchConfig
from mcpilco.search.particles import Particles, Problem
from mcpilco.search.search import SHORTEST_STRIDE, Candidate, PolicySearch, SearchResult, follow
from tests.mcpilco.search.test_search import Line, line_policy, line_problem


class Slippery(Line):
    """x' = x + 0.5 share u: the harder, the less an input does."""

    def __init__(self, share: float) -> None:
        self.share = share

    def step(self, states, inputs, noise):
        return states + (1.0 - 0.5 * self.share) * 0.5 * inputs + 0.01 * noise


def problem() -> Problem:
    return dataclasses.replace(line_problem(), dynamics=Slippery(1.0), easier=Slippery)


class Record:
    """Searches that find a policy only where it is a short way from the last one."""

    def __init__(self, reach: float, cost: float) -> None:
        self.reach, self.cost, self.at, self.visited = reach, cost, 0.0, []

    def __call__(self, search, problem, policy, fresh, trial) -> SearchResult:
        share = problem.dynamics.share
        self.visited.append((share, search.config.restarts))
        kept = abs(share - self.at) <= self.reach + 1e-12
        self.at = share if kept else self.at
        costs = torch.full((1, 1), self.cost if kept else 2 * self.cost, dtype=torch.float64)
        empty = Particles(torch.zeros(2, 1, 1), torch.zeros(1, 1, 1))
        return SearchResult(Candidate(policy, empty, costs, 7), 1, 7)


def visited(
    monkeypatch, reach: float, most: int = 100, cost: float = 0.1
) -> list[tuple[float, tuple[int, ...]]]:
    """The share of the way and the further starts of each search."""
    record = Record(reach, cost)
    monkeypatch.setattr(mcpilco.search.search.PolicySearch, "run", functools.partialmethod(record))
    config = SearchConfig(restarts=(3,), continuation=most)
    search = PolicySearch(config, torch.Generator())
    found = follow(search, problem(), line_policy(), line_policy, trial=1)
    assert (found.starts, found.steps) == (len(record.visited), 7 * len(record.visited))
    return record.visited


def test_the_way_leads_from_the_easiest_model_to_the_model_itself(monkeypatch):
    shares = [share for share, _ in visited(monkeypatch, reach=1.0)]
    assert shares == sorted(shares)
    assert (shares[0], *shares[-2:]) == (0.0, 1.0, 1.0)


def test_further_starts_are_tried_at_both_ends_alone(monkeypatch):
    first, *way, last = (restarts for _, restarts in visited(monkeypatch, reach=1.0))
    assert first == last == (3,)
    assert set(way) == {(0,)}


@pytest.mark.parametrize("reach", [0.15, 0.06, SHORTEST_STRIDE])
def test_a_step_that_loses_the_policy_is_taken_back_and_halved(monkeypatch, reach):
    shares = [share for share, _ in visited(monkeypatch, reach)]
    kept = [0.0]
    for share in shares[1:]:
        if share - kept[-1] <= reach + 1e-12:
            kept.append(share)
    assert kept[-1] == 1.0  # though no step of 0.2 would have been kept
    assert any(b < a for a, b in itertools.pairwise(shares))


def test_a_way_that_never_goes_well_ends_all_the_same(monkeypatch):
    shares = [share for share, _ in visited(monkeypatch, reach=0.0, most=10)]
    assert len(shares) == 12
    assert shares[-1] == 1.0


def test_a_policy_that_fails_in_the_easiest_model_is_not_followed(monkeypatch):
    shares = [share for share, _ in visited(monkeypatch, reach=1.0, cost=0.5)]
    assert shares == [0.0, 1.0]


def test_what_is_found_is_judged_in_the_model_itself():
    told = []
    config = SearchConfig(particles=20, steps=(10,), restarts=(0,), continuation=4)
    search = PolicySearch(config, torch.Generator().manual_seed(0), lambda *n: told.append(n))
    found = follow(search, problem(), line_policy(), line_policy, trial=1)
    again = PolicySearch(config, torch.Generator().manual_seed(1))
    own = again.run(problem().on_the_way(1.0), found.best.policy, line_policy, trial=1)
    assert found.best.cost == pytest.approx(own.best.cost, rel=0.05)
    steps = [step for step, _, _ in told]
    assert steps == list(range(1, found.steps + 1))


def starts_of(plant: dict) -> list[int]:
    """How many starts two short searches of an agent had."""
    search = SearchConfig(
        particles=8, steps=(1,), restarts=(0,), evaluation_particles=8, continuation=2
    )
    model = ModelConfig(kernel="rbf", mean="physics", plant=plant)
    config = Config(model=model, search=search, horizon=3, engine="eager")
    agent = MCPILCO("SumOfGaussians", "mcpilco/CartPoleSwingUp-v0", config=config, seed=0)
    agent.learn(total_timesteps=9)
    return [result.starts for result in agent.results]


@pytest.mark.slow
def test_the_first_search_goes_the_way_of_a_plant_with_effects():
    drag = {"name": "quadratic_drag", "target": "cart", "parameters": {"c": 0.5}}
    plant = {"format": 1, "plant": "mcpilco/CartPoleSwingUp-v0", "parameters": {}}
    assert starts_of({**plant, "effects": []}) == [1, 1]
    first, second = starts_of({**plant, "effects": [drag]})
    assert (first > 1, second) == (True, 1)
