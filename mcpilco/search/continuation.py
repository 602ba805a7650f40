"""Searches that follow a policy from an easier model to the model itself.

A plant with friction and an actuator that answers late has few policies that swing up a pole, and a
search from a random one seldom finds them. Without these effects it is easy; and what is a good
policy there becomes, by small steps of the effects, one of the plant as it is.

Reference: numerical continuation, Allgower and Georg (1990), applied to policies.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from mcpilco.policies import SumOfGaussians
from mcpilco.search.particles import Problem
from mcpilco.search.search import Candidate, PolicySearch, SearchResult

FIRST = 0.2
"""share of the way of the first step [-]"""
SHORTEST = 0.025
"""least one [-]"""
LONGER = 1.5
"""factor of a step behind one that went well [-]"""
HOPELESS = 0.25
"""a policy that costs more than this share of a random one at the end of an episode in the easiest
model is not followed [-]"""
LOST = 1.25
"""a step is taken back and halved where the cost rises by more than this factor [-]"""


def follow(
    search: PolicySearch,
    problem: Problem,
    policy: SumOfGaussians,
    fresh: Callable[[], SumOfGaussians],
    trial: int,
) -> SearchResult:
    """What a search finds that begins in the easiest model, and follows its policy from there.

    At the end of the way the search goes on as any other, from the policy that was followed.

    Args:
        search: how policies are sought in each model on the way.
        problem: what is minimised; it has easier dynamics.
        policy: the first start in the easiest of them.
        fresh: makes a random policy.
        trial: 1, 2, ..., for the schedules.
    """
    way = _Way(search, problem, fresh, trial)
    best = _arrived(way, policy, search.config.continuation)
    return SearchResult(best, way.starts, way.steps)


def _arrived(way: _Way, policy: SumOfGaussians, most: int) -> Candidate:
    """What comes of a policy that goes the whole way, in so many steps at most."""
    share, stride = 0.0, FIRST
    best = way.search_at(share, policy)
    if best.final_cost > HOPELESS * way.problem.reference_cost:
        return way.search_at(1.0, policy)
    for _ in range(most):
        if share == 1.0:
            break
        ahead = min(share + stride, 1.0)
        there = way.search_at(ahead, best.policy, restarts=(0,))
        if there.rank > LOST * best.rank and stride > SHORTEST:
            stride = max(stride / 2, SHORTEST)
        else:
            share, best, stride = ahead, there, LONGER * stride
    return way.search_at(1.0, best.policy)


class _Way:
    """The models between the easiest and the model itself, and what was spent in them."""

    def __init__(
        self,
        search: PolicySearch,
        problem: Problem,
        fresh: Callable[[], SumOfGaussians],
        trial: int,
    ) -> None:
        self.starts = self.steps = 0
        self._search, self.problem = search, problem
        self._fresh, self._trial = fresh, trial

    def search_at(self, share: float, policy: SumOfGaussians, **changed: Any) -> Candidate:
        """The best that comes of a policy in one of the models."""
        config = dataclasses.replace(self._search.config, **changed)
        part = PolicySearch(config, self._search.generator, self._report)
        found = part.run(self.problem.on_the_way(share), policy, self._fresh, self._trial)
        self.starts, self.steps = self.starts + found.starts, self.steps + found.steps
        return found.best

    def _report(self, step: int, steps: int, values: dict[str, float]) -> None:
        self._search.report(self.steps + step, self.steps + steps, values)
