"""Learning that stops at each search, so that several may be answered at once."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TypeVar

from mcpilco.policies import SumOfGaussians
from mcpilco.rollout import Problem
from mcpilco.search import PolicySearch, SearchResult


@dataclass(frozen=True)
class SearchRequest:
    """A search that waits for its answer."""

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
        return self.search.run(self.problem, self.policy, self.fresh, self.trial)


Result = TypeVar("Result")
Learning = Generator[SearchRequest, SearchResult, Result]
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
