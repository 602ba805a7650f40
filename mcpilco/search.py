"""Policy search: gradient steps on the expected cost of particles in the model."""

from __future__ import annotations

import copy
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.config import Phase, SearchConfig
from mcpilco.data import Prediction
from mcpilco.dropout import Dropout
from mcpilco.policies import SumOfGaussians
from mcpilco.rollout import Particles, Problem

logger = logging.getLogger(__name__)

MOST_SKIPPED = 20
"""a start is given up after this many steps in a row without a finite cost and gradient"""


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

    @property
    def rank(self) -> float:
        """The cost, or infinity where the model has no finite answer [-]."""
        return self.cost if math.isfinite(self.cost) else math.inf

    def prediction(self, particles: int) -> Prediction:
        """The first particles, as arrays."""
        shown = slice(particles)
        return Prediction(
            states=self.particles.states[:, shown].numpy(),
            inputs=self.particles.inputs[:, shown].numpy(),
            costs=self.costs[:, shown].numpy(),
        )


@dataclass(frozen=True)
class SearchResult:
    """The best candidate, and what was spent."""

    best: Candidate
    """the candidate of lowest cost"""
    starts: int
    """how many candidates there were"""
    steps: int
    """optimisation steps of all of them"""


class DriftMonitor:
    """Says when the cost no longer drifts.

    s = EMA(dJ) / sqrt(EMA variance), smoothed once more. The cost has settled when abs(s) stayed
    below a bound for the last `window` steps; the first `window` steps of all, while the averages
    fill, do not count.

    Reference: the authors' later setting (Amadio et al., IEEE T-RO 2022).
    """

    def __init__(self, decay: float = 0.99, window: int = 200) -> None:
        """A monitor that has seen nothing yet.

        Args:
            decay: of the exponential averages, each step [-].
            window: how long the drift must be small [steps].
        """
        self.decay = decay
        self.window = window
        self.mean = 0.0
        self.variance = 0.0
        self.drift = 0.0
        self.last: float | None = None
        self.calm = -window

    def reset(self) -> None:
        """Begin a new phase; the averages are kept."""
        self.calm = 0

    def update(self, cost: float, bound: float) -> bool:
        """Whether the cost has settled, given its newest value; NaN is passed over."""
        if not math.isfinite(cost):
            return False
        if self.last is not None:
            change = cost - self.last
            surprise = change - self.mean
            self.mean += (1 - self.decay) * surprise
            self.variance = self.decay * (self.variance + (1 - self.decay) * surprise**2)
            standardised = self.mean / math.sqrt(self.variance) if self.variance > 0 else 0.0
            self.drift = self.decay * self.drift + (1 - self.decay) * standardised
        self.last = cost
        self.calm = 0 if self.calm >= 0 and abs(self.drift) >= bound else self.calm + 1
        return self.calm >= self.window


class Schedule:
    """Which phase a step belongs to, by shares of the steps or by a monitor of the cost."""

    def __init__(self, config: SearchConfig, steps: int) -> None:
        self.phases = config.phases
        self.widest = config.widening
        self.steps = steps
        self.monitor = DriftMonitor() if config.monitored else None
        self.index = 0

    @property
    def phase(self) -> Phase:
        """The present phase."""
        return self.phases[self.index]

    def widening(self, step: int) -> float:
        """How many times as wide the cost is at a step, falling to 1 over the first half."""
        return max(1.0, self.widest + (1.0 - self.widest) * 2 * step / self.steps)

    def advance(self, step: int, cost: float) -> bool:
        """Take note of a finished step; False when the search is over."""
        last = self.index == len(self.phases) - 1
        if self.monitor is not None:
            if self.monitor.update(cost, self.phase.drift):
                if last:
                    return False
                self.monitor.reset()
                self.index += 1
        elif not last and step >= self.phase.until * self.steps:
            self.index += 1
        return step < self.steps


class PolicySearch:
    """Improves a policy in a model, from one or several starts."""

    def __init__(
        self,
        config: SearchConfig,
        generator: torch.Generator,
        report: Callable[[int, int, dict[str, float]], None] = lambda step, steps, values: None,
    ) -> None:
        """A search.

        Args:
            config: its numbers.
            generator: source of particles and masks.
            report: called after each step with (steps done, present upper bound, values by name).
        """
        self.config = config
        self.generator = generator
        self.report = report

    def run(
        self,
        problem: Problem,
        policy: SumOfGaussians,
        fresh: Callable[[], SumOfGaussians],
        trial: int,
    ) -> SearchResult:
        """The policy of lowest predicted cost among the starts tried.

        A further start from a fresh random policy is tried while the model predicts failure: while
        the best candidate's mean cost over the last third of the horizon exceeds the share
        `failing` of the cost of a step without a policy. The rule needs no knowledge of the task
        beyond its cost. A start that meets costs or gradients that are not finite is given up
        after `MOST_SKIPPED` of them; where all are, the first one's policy is returned.

        Args:
            problem: what is minimised.
            policy: the first start; it is not changed.
            fresh: makes a random policy.
            trial: 1, 2, ..., for the schedules.
        """
        spent = 0
        candidates: list[Candidate] = []
        for start in range(self.config.restarts + 1):
            first = policy if start == 0 else fresh()
            candidate = self._improve(problem, first, trial, start, spent)
            candidates.append(candidate)
            spent += candidate.steps
            best = min(candidates, key=lambda candidate: candidate.rank)
            if best.final_cost <= self.config.failing * problem.reference_cost:
                break
        return SearchResult(best, len(candidates), spent)

    def _improve(
        self, problem: Problem, policy: SumOfGaussians, trial: int, start: int, spent: int
    ) -> Candidate:
        """One start: gradient steps until the schedule ends."""
        policy = copy.deepcopy(policy)
        optimiser = torch.optim.Adam(policy.parameters())
        steps, rate = self.config.steps_of(trial), self.config.rate_of(trial)
        schedule = Schedule(self.config, steps)
        step, skipped = 0, 0
        while True:
            phase = schedule.phase
            optimiser.param_groups[0]["lr"] = rate * phase.learning_rate
            widening = schedule.widening(step)
            cost, norm = self.step(problem, policy, optimiser, phase.dropout, widening)
            step += 1
            skipped = 0 if math.isfinite(cost) and math.isfinite(norm) else skipped + 1
            if skipped == MOST_SKIPPED:
                logger.warning("Start %d given up: its costs are not finite.", start + 1)
                break
            values = {
                "policy/cost": cost,
                "policy/gradient_norm": norm,
                "policy/learning_rate": rate * phase.learning_rate,
                "policy/dropout": phase.dropout,
                "policy/start": float(start + 1),
            }
            self.report(spent + step, spent + steps, values)
            if not schedule.advance(step, cost):
                break
        return self._judge(problem, policy, step)

    def step(
        self,
        problem: Problem,
        policy: SumOfGaussians,
        optimiser: torch.optim.Optimizer,
        dropout: float = 0.0,
        widening: float = 1.0,
    ) -> tuple[float, float]:
        """One gradient step; returns the cost and the gradient's norm before clipping [-].

        The gradient is that of the cost made `widening` times as wide; the cost returned is the
        task's own. Where one of them is not finite, the policy stays as it is.
        """
        mask = None
        if dropout > 0:
            mask = Dropout(dropout, int(torch.randint(2**31, (1,), generator=self.generator)))
        particles = problem.particles(policy, self.config.particles, self.generator, mask)
        felt = problem.widened(widening).costs(particles).mean(1).sum()
        optimiser.zero_grad()
        felt.backward()
        limit = math.inf if self.config.clip_norm is None else self.config.clip_norm
        norm = float(torch.nn.utils.clip_grad_norm_(policy.parameters(), limit))
        with torch.no_grad():
            value = float(felt if widening == 1.0 else problem.costs(particles).mean(1).sum())
        if math.isfinite(value) and math.isfinite(norm):
            optimiser.step()
        return value, norm

    def _judge(self, problem: Problem, policy: SumOfGaussians, steps: int) -> Candidate:
        """What the model says of a policy, without dropout."""
        with torch.no_grad():
            particles = problem.particles(policy, self.config.evaluation_particles, self.generator)
            return Candidate(policy, particles, problem.costs(particles), steps)
