"""Learning that stops at each search, so that several may be answered at once."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from mcpilco.data import Prediction
from mcpilco.policies import SumOfGaussians
from mcpilco.search import PolicySearch, Problem, SearchResult, Spent, follow


class BestPolicy(Protocol):
    """The best policy of a search, and what the model says of it."""

    @property
    def policy(self) -> Any: ...
    @property
    def cost(self) -> float:
        """Expected, summed over the steps [-]."""
        ...

    @property
    def cost_std(self) -> float:
        """Standard deviation of that sum [-]."""
        ...

    def prediction(self, particles: int) -> Prediction: ...


class Found(Protocol):
    """What a search comes back with, such as `mcpilco.search.search.SearchResult`."""

    @property
    def best(self) -> BestPolicy: ...
    @property
    def starts(self) -> int: ...
    @property
    def steps(self) -> int: ...
    @property
    def spent(self) -> Spent: ...


class Request(Protocol):
    """A search that waits for its answer, whatever the algorithm."""

    def answer(self) -> Found:
        """The result of this search alone."""
        ...


@dataclass(frozen=True)
class SearchRequest:
    """A search of MC-PILCO that waits for its answer; several can be answered together."""

    search: PolicySearch
    """how to search, and from which random numbers"""
    problem: Problem
    """what is minimised"""
    policy: SumOfGaussians
    """the first start"""
    fresh: Callable[[], SumOfGaussians]
    """makes a random policy"""
    trial: int
    """1, 2, ..., for the schedules"""

    def answer(self) -> SearchResult:
        """The result of this search alone."""
        if self.problem.easier is not None:
            return follow(self.search, self.problem, self.policy, self.fresh, self.trial)
        return self.search.run(self.problem, self.policy, self.fresh, self.trial)


Result = TypeVar("Result")
Learning = Generator[Request, Found, Result]
"""work that stops at each search until it is sent the answer"""


def answer_alone(learning: Learning[Result]) -> Result:
    """What a learning returns whose searches are run one by one, as they come."""
    go_on = functools.partial(learning.send, None)  # type: ignore[arg-type]  # the first is None
    with contextlib.closing(learning):
        while True:
            try:
                request = go_on()
            except StopIteration as end:
                return end.value
            try:
                go_on = functools.partial(learning.send, request.answer())
            except Exception as error:  # the learning knows whether it can go on without an answer
                go_on = functools.partial(learning.throw, error)
