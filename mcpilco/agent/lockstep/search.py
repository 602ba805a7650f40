"""The answers to several search requests, computed together."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from mcpilco.agent.learning import SearchRequest
from mcpilco.agent.lockstep.costs import CostBatch
from mcpilco.agent.lockstep.descent import Member, Place, descend, judge
from mcpilco.search import Descent, SearchResult, Spent, Starts, Stopwatch, batched
from mcpilco.typing import InputError


def search_together(
    requests: Sequence[SearchRequest],
    device: torch.device | str = "cpu",
    dtype: torch.dtype = torch.float64,
) -> list[SearchResult]:
    """What `SearchRequest.answer` says of each request, to rounding, on the CPU.

    On another device each search draws its particles from a generator there, which starts from
    the search's own: the result is another one, and does not depend on the batch either. A start
    that its schedule ends, or that is given up, leaves the batch; only searches whose models
    predict failure start again.

    Args:
        requests: of one configuration, trial and task.
        device: where particles are rolled out.
        dtype: precision of the rollouts.

    Raises:
        InputError: the requests do not belong together, or a model or policy does not fit.
    """
    _check(requests)
    place, costs = Place(torch.device(device), dtype), CostBatch()
    seeds = [_Seed(request, place) for request in requests]
    if requests[0].search.config.polish:
        _judge_first(seeds, place, costs)
    while wanting := [seed for seed in seeds if seed.starts.wanted]:
        for half_way in (False, True):  # the steps of a batch have one schedule
            alike = [seed for seed in wanting if seed.starts.half_way == half_way]
            if alike:
                _try_once(alike, place, costs)
    return [seed.starts.result(seed.spent) for seed in seeds]


def _judge_first(seeds: Sequence[_Seed], place: Place, costs: CostBatch) -> None:
    """What the models say of the policies that the searches begin with."""
    watch = Stopwatch()
    found = judge([seed.member() for seed in seeds], place, costs)
    spent = watch.read().share(len(seeds))
    for seed, candidate in zip(seeds, found, strict=True):
        seed.starts.unimproved = candidate
        seed.spent += spent


def _try_once(seeds: Sequence[_Seed], place: Place, costs: CostBatch) -> None:
    """The next start of each seed."""
    watch = Stopwatch()
    members = [seed.member() for seed in seeds]
    found = descend(members, place, costs)
    spent = watch.read().share(len(seeds))
    for seed, member, candidate in zip(seeds, members, found, strict=True):
        seed.starts.add(candidate, member.descent)
        seed.spent += spent


class _Seed:
    """A request with its starts."""

    def __init__(self, request: SearchRequest, place: Place) -> None:
        self.request = request
        self.spent = Spent()
        config, reference = request.search.config, request.problem.reference_cost
        self.starts = Starts(config, reference, request.policy, request.fresh, request.trial)
        self._generator = _generator_on(place.device, request.search.generator)

    def member(self) -> Member:
        """Its next start."""
        descent = Descent(self.request.search, self.request.trial, self.starts)
        return Member(self.request, self._generator, self.starts.next(), descent)


def _generator_on(device: torch.device, generator: torch.Generator) -> torch.Generator:
    """The generator itself on its own device, else one there that starts from it."""
    if device.type == generator.device.type:
        return generator
    seed = int(torch.randint(2**31, (1,), generator=generator))
    return torch.Generator(device).manual_seed(seed)


def _check(requests: Sequence[SearchRequest]) -> None:
    strange = {type(r).__name__ for r in requests if not isinstance(r, SearchRequest)}
    if strange:
        raise InputError(
            f"Searches of MC-PILCO run together, got {', '.join(sorted(strange))}; run the seeds "
            "of other algorithms one by one, without a device."
        )
    kinds = {(r.search.config, r.trial, r.problem.horizon) for r in requests}
    if len(kinds) != 1:
        raise InputError(
            "Searches run together when they have one configuration, trial and horizon, "
            f"got {len(kinds)} kinds; answer each kind by itself."
        )
    if any(r.problem.observer is not None for r in requests):
        raise InputError(
            "Seeds run together where policies see the states of the particles, got a task whose "
            "states are measured in part, or an actuator that answers late; run them one by one, "
            "without a device."
        )
    if not all(batched.supports(r.problem.dynamics, r.policy) for r in requests):
        raise InputError(
            "Seeds run together with a GP of sums and products of RBF, Linear and MPK kernels and "
            "a SumOfGaussians policy; run them one by one."
        )
