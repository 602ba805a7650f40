"""Policy search: gradient steps on the expected cost of particles in the model."""

from __future__ import annotations

import copy
import dataclasses
import logging
import math
import statistics
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.config import Phase, SearchConfig
from mcpilco.data import Prediction
from mcpilco.policies import Dropout, SumOfGaussians
from mcpilco.search.limits import Lagrangian
from mcpilco.search.particles import Particles, Problem
from mcpilco.search.schedule import Schedule

logger = logging.getLogger(__name__)

Fresh = Callable[[], SumOfGaussians]
"""makes a random policy"""

MOST_SKIPPED = 20
"""a start is given up after this many steps in a row without a finite cost and gradient"""

STEPS_OF_MARK = 10
"""a start is screened by its mean cost over so many steps, for a single one's is noisy"""


@dataclass(frozen=True)
class Candidate:
    """A policy that one start of the search arrived at, and what the model says of it."""

    policy: SumOfGaussians
    """its parameters are finite"""
    particles: Particles
    """what the model expects of it"""
    costs: Float[Tensor, "T P"]
    """of these particles at the end of each step [-]"""
    steps: int
    """optimisation steps spent on it"""
    kept: float | None = None
    """share of these particles that keep the limits at every step [-]; None: there are none"""
    admissible: bool = True
    """whether these are as many as must"""

    @property
    def cost(self) -> float:
        """Sum over steps of the mean over particles [-].

        Reference: thesis eq. (5.8).
        """
        return float(self.costs.mean(1).sum())

    @property
    def cost_std(self) -> float:
        """Standard deviation over particles of a particle's summed cost [-]."""
        return float(self.costs.sum(0).std())

    @property
    def final_cost(self) -> float:
        """Mean cost over the last third of the horizon [-]."""
        return float(self.costs[-math.ceil(len(self.costs) / 3) :].mean())

    def fails(self, config: SearchConfig, reference_cost: float) -> bool:
        """Whether the model predicts failure, see `Starts`."""
        return not (self.admissible and self.final_cost <= config.failing * reference_cost)

    @property
    def rank(self) -> float:
        """The cost, or infinity where the model has no finite answer or limits are not kept [-]."""
        return self.cost if self.admissible and math.isfinite(self.cost) else math.inf

    def prediction(self, particles: int) -> Prediction:
        """The first particles, as arrays."""
        shown = slice(particles)
        return Prediction(
            states=self.particles.states[:, shown].numpy(),
            inputs=self.particles.inputs[:, shown].numpy(),
            costs=self.costs[:, shown].numpy(),
        )


AnyCandidate = TypeVar("AnyCandidate")


@dataclass(frozen=True)
class SearchResult(Generic[AnyCandidate]):
    """The best candidate, and what was spent."""

    best: AnyCandidate
    """the candidate of lowest cost"""
    starts: int
    """how many candidates there were"""
    steps: int
    """optimisation steps of all of them"""


class Starts:
    """The starts of one search: which comes next, whether one is wanted, the best so far.

    A further start from a fresh random policy is wanted while the model predicts failure: while the
    best candidate's mean cost over the last third of the horizon exceeds the share `failing` of the
    cost of a step without a policy. The rule needs no knowledge of the task beyond its cost.
    """

    def __init__(
        self,
        config: SearchConfig,
        reference_cost: float,
        policy: SumOfGaussians,
        fresh: Fresh,
        trial: int,
    ) -> None:
        self._most = config.starts_of(trial)
        self._fails = partial(Candidate.fails, config=config, reference_cost=reference_cost)
        self._policy = policy
        self._fresh = fresh
        self.unimproved: Candidate | None = None
        """the first policy as it is, where that counts"""
        self.tried: list[Candidate] = []
        """what came of each start"""
        self._marks: list[float] = []

    @property
    def wanted(self) -> bool:
        """Whether to try one more."""
        return not self.tried or (len(self.tried) < self._most and self._fails(self.best))

    @property
    def half_way(self) -> bool:
        """Whether the next start enters the schedule half-way, for its policy needs polish only."""
        return not self.tried and self.unimproved is not None and not self._fails(self.unimproved)

    def next(self) -> SumOfGaussians:
        """The policy to start from; random numbers are drawn for all but the first."""
        return self._fresh() if self.tried else self._policy

    def add(self, candidate: Candidate, descent: Descent) -> None:
        """Take note of what came of a start, and of how it came there."""
        self.tried.append(candidate)
        self._marks.append(descent.mark)

    @property
    def bar(self) -> float:
        """Median cost of the starts where they are screened, which the next must not exceed [-]."""
        return statistics.median_low(self._marks) if self._marks else math.inf

    @property
    def best(self) -> Candidate:
        """The candidate of lowest predicted cost; where none is admissible, the nearest to it."""
        first = [] if self.unimproved is None else [self.unimproved]
        return min(first + self.tried, key=lambda found: (found.rank, -(found.kept or 0.0)))

    @property
    def steps(self) -> int:
        """Optimisation steps spent so far."""
        return sum(candidate.steps for candidate in self.tried)

    def result(self) -> SearchResult[Candidate]:
        """The best candidate, and the effort spent on all."""
        return SearchResult(self.best, len(self.tried), self.steps)


class Descent:
    """One start on its way: the settings of its next step, and whether there is one."""

    def __init__(self, search: PolicySearch, trial: int, starts: Starts) -> None:
        self.step = 0
        """steps done"""
        self.over = False
        """no more steps are to be done"""
        self.mark = math.inf
        """mean cost of the steps before the start was screened [-]; infinite where it was not"""
        self._report = search.report
        steps = search.config.steps_of(trial)
        self._entered = steps // 2 if starts.half_way else 0
        self._steps = steps - self._entered
        self._rate = search.config.rate_of(trial)
        self._schedule = Schedule(search.config, steps, self._entered)
        self._start = len(starts.tried)
        self._before = starts.steps
        self._skipped = 0
        share = search.config.screening
        self._screened_at = round(share * steps) if share < 1 and not starts.half_way else 0
        self._bar = starts.bar
        self._last: deque[float] = deque(maxlen=STEPS_OF_MARK)

    @property
    def phase(self) -> Phase:
        """The present phase."""
        return self._schedule.phase

    @property
    def learning_rate(self) -> float:
        """Adam's step size in the next step [-]."""
        return self._rate * self.phase.learning_rate

    @property
    def widening(self) -> float:
        """How many times as wide the cost is in the next step [-]."""
        return self._schedule.widening(self._entered + self.step)

    @property
    def progress(self) -> float:
        """The share of the schedule that is done [-]."""
        return (self._entered + self.step) / (self._entered + self._steps)

    def note(self, cost: float, norm: float) -> None:
        """Take note of a step that was done, by its cost and its gradient's norm [-]."""
        self.step += 1
        finite = math.isfinite(cost) and math.isfinite(norm)
        self._skipped = 0 if finite else self._skipped + 1
        if self._skipped == MOST_SKIPPED:
            logger.warning("Start %d given up: its costs are not finite.", self._start + 1)
            self.over = True
            return
        values = {
            "policy/cost": cost,
            "policy/gradient_norm": norm,
            "policy/learning_rate": self.learning_rate,
            "policy/dropout": self.phase.dropout,
            "policy/start": float(self._start + 1),
        }
        self._report(self._before + self.step, self._before + self._steps, values)
        self.over = not self._schedule.advance(self._entered + self.step, cost)
        self._last.append(cost)
        if self.step == self._screened_at:
            self.mark = sum(self._last) / len(self._last)
            self.over |= self.mark > self._bar


class Adam:
    """`torch.optim.Adam(..., fused=True)` without its class, which imports a compiler for 1.6 s.

    Reference: Kingma & Ba, Adam: a method for stochastic optimization, ICLR 2015, algorithm 1.
    """

    def __init__(self, policy: SumOfGaussians) -> None:
        self.parameters = [parameter.detach() for parameter in policy.parameters()]
        self._means = [torch.zeros_like(parameter) for parameter in self.parameters]
        self._squares = [torch.zeros_like(parameter) for parameter in self.parameters]
        self._steps = [torch.zeros(()) for _ in self.parameters]

    def step(self, slopes: Sequence[Tensor], learning_rate: float) -> None:
        """Change the policy's parameters by their slopes."""
        torch._foreach_add_(self._steps, 1)
        torch._fused_adam_(
            self.parameters,
            [slope.contiguous() for slope in slopes],  # it reads memory, not strides
            self._means,
            self._squares,
            [],
            self._steps,
            lr=learning_rate,
            beta1=0.9,
            beta2=0.999,
            weight_decay=0.0,
            eps=1e-8,
            amsgrad=False,
            maximize=False,
        )


class PolicySearch:
    """Improves a policy in a model, from one or several starts."""

    def __init__(
        self,
        config: SearchConfig,
        generator: torch.Generator,
        report: Callable[[int, int, dict[str, float]], None] = lambda step, steps, values: None,
    ) -> None:
        """A search.

        `report` is called after each step with (steps done, present upper bound, values by name).
        """
        self.config = config
        self.generator = generator
        self.report = report

    def run(
        self, problem: Problem, policy: SumOfGaussians, fresh: Fresh, trial: int
    ) -> SearchResult[Candidate]:
        """The policy of lowest predicted cost among the first one and what came of the starts.

        `Starts` says which are tried. A start that meets costs or gradients that are not finite is
        given up after `MOST_SKIPPED` of them; where all are, the first one's policy is returned.

        The policy is the first start, and is not changed.
        """
        starts = Starts(self.config, problem.reference_cost, policy, fresh, trial)
        if self.config.polish:
            starts.unimproved = self._judge(problem, copy.deepcopy(policy), steps=0)
        while starts.wanted:
            descent = Descent(self, trial, starts)
            starts.add(self._improve(problem, starts.next(), descent), descent)
        return starts.result()

    def _improve(self, problem: Problem, policy: SumOfGaussians, descent: Descent) -> Candidate:
        """One start: gradient steps until the schedule ends."""
        policy = copy.deepcopy(policy)
        adam = Adam(policy)
        limits, reference = problem.limits, problem.reference_cost
        within = None if limits is None else Lagrangian(limits, reference, problem.horizon)
        while not descent.over:
            objective = None if within is None else partial(within.of, progress=descent.progress)
            numbers = descent.learning_rate, descent.phase.dropout, descent.widening, objective
            descent.note(*self.step(problem, policy, adam, *numbers))
        return self._judge(problem, policy, descent.step)

    def step(
        self,
        problem: Problem,
        policy: SumOfGaussians,
        adam: Adam,
        learning_rate: float,
        dropout: float = 0.0,
        widening: float = 1.0,
        objective: Callable[[Tensor, Tensor], Tensor] | None = None,
    ) -> tuple[float, float]:
        """One gradient step; returns the cost and the gradient's norm before clipping [-].

        The gradient is that of the cost made `widening` times as wide, or of an objective of that
        and the states behind each step; the cost returned is the task's own. Where one of them is
        not finite, the policy stays as it is.
        """
        mask = None
        if dropout > 0:
            mask = Dropout(dropout, int(torch.randint(2**31, (1,), generator=self.generator)))
        particles = problem.particles(policy, self.config.particles, self.generator, mask)
        costs = problem.widened(widening).costs(particles)
        annealed = costs.mean(1).sum()
        descended = annealed if objective is None else objective(particles.states[1:], costs)
        slopes = torch.autograd.grad(descended, list(policy.parameters()))
        norm = torch.linalg.vector_norm(torch.stack(torch._foreach_norm(slopes)))
        if self.config.clip_norm is not None:
            shrunk = torch.clamp(self.config.clip_norm / (norm + 1e-6), max=1.0)
            slopes = torch._foreach_mul(slopes, shrunk)
        with torch.no_grad():
            value = float(annealed if widening == 1.0 else problem.costs(particles).mean(1).sum())
        if math.isfinite(value) and norm.isfinite():
            adam.step(slopes, learning_rate)
        return value, float(norm)

    def _judge(self, problem: Problem, policy: SumOfGaussians, steps: int) -> Candidate:
        """Predicted particles and costs of a policy, without dropout."""
        with torch.no_grad():
            particles = problem.particles(policy, self.config.evaluation_particles, self.generator)
            costs, limits = problem.costs(particles), problem.limits
            if limits is None:
                return Candidate(policy, particles, costs, steps)
            kept = limits.kept(particles.states[1:])
            return Candidate(policy, particles, costs, steps, kept, kept >= limits.share)


# --- continuation ---------------------------------------------------------------------------------
#
# A plant with friction and an actuator that answers late has few policies that swing up a pole, and
# a search from a random one seldom finds them. Without these effects it is easy; and a good policy
# there becomes, by small steps of the effects, one of the plant as it is.

FIRST_STRIDE = 0.2
"""share of the way of the first step [-]"""
SHORTEST_STRIDE = 0.025
"""least one [-]"""
STRIDE_GROWTH = 1.5
"""factor of a step behind one that went well [-]"""
HOPELESS_SHARE = 0.25
"""a policy that costs more than this share of a random one at the end of an episode in the easiest
model is not followed [-]"""
LOST_FACTOR = 1.25
"""a step is taken back and halved where the cost rises by more than this factor [-]"""


def follow(
    search: PolicySearch, problem: Problem, policy: SumOfGaussians, fresh: Fresh, trial: int
) -> SearchResult[Candidate]:
    """Search in the easiest model first, and follow the policy from there to the model itself.

    At the end of the way the search goes on as any other, from the policy that was followed.

    Reference: numerical continuation, Allgower and Georg (1990), applied to policies.

    Arguments are those of `PolicySearch.run`; the problem has easier dynamics.
    """
    way = _Way(search, problem, fresh, trial)
    share, stride = 0.0, FIRST_STRIDE
    best = way.search_at(share, policy)
    if best.final_cost > HOPELESS_SHARE * problem.reference_cost:
        return way.ended(policy)
    for _ in range(search.config.continuation):
        if share == 1.0:
            break
        ahead = min(share + stride, 1.0)
        there = way.search_at(ahead, best.policy, restarts=(0,))
        if there.rank > LOST_FACTOR * best.rank and stride > SHORTEST_STRIDE:
            stride = max(stride / 2, SHORTEST_STRIDE)
        else:
            share, best, stride = ahead, there, STRIDE_GROWTH * stride
    return way.ended(best.policy)


class _Way:
    """The models between the easiest and the model itself, and what was spent in them."""

    def __init__(self, search: PolicySearch, problem: Problem, fresh: Fresh, trial: int) -> None:
        self.starts = self.steps = 0
        self._search, self._problem = search, problem
        self._fresh, self._trial = fresh, trial

    def search_at(self, share: float, policy: SumOfGaussians, **changed: Any) -> Candidate:
        """The best that comes of a policy in one of the models."""
        config = dataclasses.replace(self._search.config, **changed)
        part = PolicySearch(config, self._search.generator, self._report)
        found = part.run(self._problem.on_the_way(share), policy, self._fresh, self._trial)
        self.starts, self.steps = self.starts + found.starts, self.steps + found.steps
        return found.best

    def ended(self, policy: SumOfGaussians) -> SearchResult[Candidate]:
        """The best that comes of a policy in the model itself, and what was spent on the way."""
        return SearchResult(self.search_at(1.0, policy), self.starts, self.steps)

    def _report(self, step: int, steps: int, values: dict[str, float]) -> None:
        self._search.report(self.steps + step, self.steps + steps, values)
