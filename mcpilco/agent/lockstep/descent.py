"""One start of each of several searches, improved step by step together."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.agent.learning import SearchRequest
from mcpilco.agent.lockstep.adam import AdamBatch, clipped
from mcpilco.agent.lockstep.costs import CostBatch
from mcpilco.dynamics import GPDynamics
from mcpilco.policies import Dropout, SumOfGaussians
from mcpilco.search import (
    Candidate,
    Descent,
    MaskBatch,
    ModelBatch,
    Particles,
    PolicyBatch,
    Problem,
    rollout_batch,
)


@dataclass(frozen=True)
class Place:
    """Where and how a batch computes."""

    device: torch.device
    """of all arrays"""
    dtype: torch.dtype = torch.float64
    """of rollouts and costs; parameters and factorisations have double precision"""


@dataclass(frozen=True)
class Member:
    """A seed in the batch."""

    request: SearchRequest
    """what it wants to know"""
    generator: torch.Generator
    """of its particles; on the device"""
    policy: SumOfGaussians
    """where this start begins"""
    descent: Descent
    """how far it is"""

    @property
    def problem(self) -> Problem:
        """What is minimised."""
        return self.request.problem

    def mask(self) -> Dropout | None:
        """Of the next step, from the search's own random numbers."""
        rate = self.descent.phase.dropout
        if rate == 0:
            return None
        generator = self.request.search.generator
        return Dropout(rate, int(torch.randint(2**31, (1,), generator=generator)))


class Batch:
    """The members' models in one set of arrays, and their particles."""

    def __init__(self, members: Sequence[Member], place: Place, costs: CostBatch) -> None:
        self._problems = [member.problem for member in members]
        self._generators = [member.generator for member in members]
        dynamics = [cast(GPDynamics, problem.dynamics) for problem in self._problems]
        self._models = ModelBatch.of(dynamics).to(place.device, place.dtype)
        self._mean = self._stacked("start_mean", place)
        self._std = self._stacked("start_std", place)
        self._costs = costs

    def _stacked(self, name: str, place: Place) -> Float[Tensor, "S 1 X"]:
        rows = [getattr(problem, name) for problem in self._problems]
        return torch.stack(rows)[:, None].to(place.device)

    def particles(
        self, policies: PolicyBatch, count: int, masks: MaskBatch | None = None
    ) -> tuple[Float[Tensor, "S T_plus_1 P X"], Float[Tensor, "S T P U"]]:
        """`count` particles of each seed, from fresh random numbers of its own generator."""
        pairs = zip(self._problems, self._generators, strict=True)
        drawn = [problem.normals(count, generator) for problem, generator in pairs]
        normal, noise = (torch.stack(part) for part in zip(*drawn, strict=True))
        start = self._mean + self._std * normal
        return rollout_batch(self._models, policies, start, noise, masks)

    def costs(
        self, states: Tensor, inputs: Tensor, widening: float = 1.0
    ) -> Float[Tensor, "S T P"]:
        """Cost of each particle at the end of each step [-]."""
        return self._costs(self._problems, states, inputs, widening)


def descend(members: Sequence[Member], place: Place, costs: CostBatch) -> list[Candidate]:
    """What comes of one start of each member, in their order."""
    template = _policies(members, place)
    adam = AdamBatch(template.flat())
    found = adam.numbers.clone()
    running, batch = list(range(len(members))), Batch(members, place, costs)
    while running:
        _step([members[i] for i in running], batch, template, adam, place)
        over = [i for i in running if members[i].descent.over]
        if over:
            found[over] = adam.numbers[[running.index(i) for i in over]]
            stay = [row for row, i in enumerate(running) if i not in over]
            running = [running[row] for row in stay]
            adam.keep(stay)
            if running:
                batch = Batch([members[i] for i in running], place, costs)
    return _judged(members, Batch(members, place, costs), template.holding(found))


def _step(
    members: Sequence[Member], batch: Batch, template: PolicyBatch, adam: AdamBatch, place: Place
) -> None:
    """One gradient step of each member; what `PolicySearch.step` does for one."""
    config, first = members[0].request.search.config, members[0].descent
    policies = template.holding(adam.numbers)
    masks = MaskBatch.of([member.mask() for member in members], members[0].problem.horizon)
    masks = None if masks is None else masks.to(place.device, place.dtype)
    states, inputs = batch.particles(policies, config.particles, masks)
    felt = batch.costs(states, inputs, first.widening).mean(2).sum(1)
    gradients = torch.autograd.grad(felt.sum(), policies.parameters)
    gradient, norm = clipped(
        torch.cat([part.flatten(1) for part in gradients], 1), config.clip_norm
    )
    with torch.no_grad():
        own = felt if first.widening == 1.0 else batch.costs(states, inputs).mean(2).sum(1)
        rates = [member.descent.learning_rate for member in members]
        rate = torch.tensor(rates, dtype=torch.float64).to(place.device)
        adam.step(gradient, rate, own.isfinite() & norm.isfinite())
        # the one look at the device in a step: schedules depend on the costs
        numbers = torch.stack([own.to(norm), norm], 1).tolist()
    for member, (cost, length) in zip(members, numbers, strict=True):
        member.descent.note(cost, length)


def judge(members: Sequence[Member], place: Place, costs: CostBatch) -> list[Candidate]:
    """What the models say of the members' policies as they are."""
    return _judged(members, Batch(members, place, costs), _policies(members, place))


def _policies(members: Sequence[Member], place: Place) -> PolicyBatch:
    """Where the members begin."""
    template = PolicyBatch.of([member.policy for member in members])
    frame, numbers = template.frame.to(place.device), template.flat().to(place.device)
    return dataclasses.replace(template, frame=frame).holding(numbers)


@torch.no_grad()
def _judged(members: Sequence[Member], batch: Batch, policies: PolicyBatch) -> list[Candidate]:
    """What the models say of the policies, without dropout."""
    count = members[0].request.search.config.evaluation_particles
    states, inputs = batch.particles(policies, count)
    arrays = [array.cpu().double() for array in (states, inputs, batch.costs(states, inputs))]
    candidates = []
    for i, member in enumerate(members):
        policy = copy.deepcopy(member.policy)
        own = policy.centres, policy.log_lengthscale, policy.weights
        for mine, learned in zip(own, policies.parameters, strict=True):
            mine.copy_(learned[i])
        states_i, inputs_i, costs_i = (array[i] for array in arrays)
        particles = Particles(states_i, inputs_i)
        candidates.append(Candidate(policy, particles, costs_i, member.descent.step))
    return candidates
