"""PILCO's policy search: L-BFGS on the expected cost of one predicted Gaussian."""

from __future__ import annotations

import contextlib
import copy
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import minimize
from threadpoolctl import threadpool_limits
from torch import Tensor
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from baselines.moments.costs import expected_cost
from baselines.moments.image import Gaussian
from baselines.pilco.model import PilcoConfig
from baselines.pilco.rollout import GaussianDynamics, GPMean, predicted
from mcpilco.data import Prediction
from mcpilco.search import SearchResult
from mcpilco.typing import Cost

_REMEMBERED = 50
"""steps that L-BFGS remembers: most of a search, so that it is nearly BFGS"""
_SPREAD_PARTICLES = 384
"""particles that the spread of the cost is estimated from"""

Report = Callable[[int, int, dict[str, float]], None]
"""called after each evaluation: evaluations done, most of them, values by name"""


@dataclass(frozen=True)
class Problem:
    """The objective: the expected cost over the horizon, of one Gaussian in a model."""

    dynamics: GaussianDynamics
    """the model"""
    cost: Cost
    """one that `baselines.moments.expected_cost` knows"""
    start: Gaussian
    """the state at time 0"""
    horizon: int
    """T [steps]"""

    def prediction(self, policy: GPMean) -> tuple[Gaussian, Gaussian, Float[Tensor, " T"]]:
        """The states at times 0 to T, the inputs between, and the expected cost of each step [-].

        Raises:
            torch.linalg.LinAlgError: a predicted covariance is none, for its numbers overflow.
        """
        states, inputs = predicted(self.dynamics, policy, self.start, self.horizon)
        after = Gaussian(states.mean[1:], states.cov[1:])
        return states, inputs, expected_cost(self.cost, after, inputs)


@dataclass(frozen=True)
class Candidate:
    """A policy, and what the model says of it."""

    policy: GPMean
    """its parameters are finite"""
    problem: Problem
    """what was minimised"""
    states: Gaussian
    """at times 0 to T"""
    costs: Float[Tensor, " T"]
    """expected, after each step [-]"""
    normal: Float[Tensor, "P X"]
    """standard normal numbers, one row for each particle that stands for the Gaussians"""

    @property
    def cost(self) -> float:
        """Sum over the steps of the expected cost [-]."""
        return float(self.costs.sum())

    @property
    def final_cost(self) -> float:
        """Mean expected cost over the last third of the horizon [-]."""
        return float(self.costs[-math.ceil(len(self.costs) / 3) :].mean())

    @property
    def cost_std(self) -> float:
        """Standard deviation over the particles of `prediction` of their summed costs [-]."""
        return float(self.prediction(len(self.normal)).costs.sum(0).std(ddof=1))

    @torch.no_grad()
    def prediction(self, particles: int) -> Prediction:
        """Particles that have the predicted Gaussian at each step.

        A particle keeps its place in the Gaussian, x_t = m_t + S_t^1/2 n: moments that were matched
        tell how the states of a step are spread, and no path through the steps.
        """
        values, vectors = torch.linalg.eigh(self.states.cov)
        root = vectors * values.clamp_min(0.0).sqrt()[..., None, :] @ vectors.mT
        states = self.states.mean[:, None, :] + self.normal[:particles] @ root
        inputs = self.policy(states[:-1])
        costs = self.problem.cost(states[1:], inputs)
        return Prediction(states.numpy(), inputs.numpy(), costs.numpy())


@dataclass(frozen=True)
class Starts:
    """Where a search begins, but for the last policy."""

    fresh: Callable[[], GPMean]
    """makes a random policy"""
    further: int = 0
    """most starts from random ones while the model predicts failure"""
    failing: float = math.inf
    """failure is a mean expected cost over the last third of the horizon above this [-]"""


def pilco_search(
    config: PilcoConfig,
    problem: Problem,
    policy: GPMean,
    starts: Starts,
    generator: torch.Generator,
    report: Report,
) -> SearchResult[Candidate]:
    """The policy of the lowest expected cost that L-BFGS meets from a policy, which stays.

    Where the model has no finite answer to it the search starts from a random one; the generator
    draws the particles that are shown.

    Raises:
        torch.linalg.LinAlgError: the model has no finite answer to either start.
    """
    objectives = [Objective(problem, copy.deepcopy(policy), config, report)]
    with threadpool_limits(1):  # the loops multiply small matrices
        begun = 1
        if not math.isfinite(objectives[0].value(policy)):
            begun += 1
            if not math.isfinite(objectives[0].value(starts.fresh())):
                raise torch.linalg.LinAlgError(
                    "The model predicts nothing finite, neither for the last policy nor for a "
                    "random one."
                )
        best = _descended(objectives[0], config, generator)
        for _ in range(starts.further):
            if best.final_cost <= starts.failing:
                break
            begun += 1
            first = starts.fresh()
            objectives.append(Objective(problem, copy.deepcopy(first), config, report))
            if math.isfinite(objectives[-1].value(first)):
                other = _descended(objectives[-1], config, generator)
                best = min(best, other, key=lambda candidate: candidate.cost)
        return SearchResult(best, begun, sum(objective.count for objective in objectives))


def _descended(objective: Objective, config: PilcoConfig, generator: torch.Generator) -> Candidate:
    """The policy at which L-BFGS arrives from the best point so far."""
    limits = {"maxiter": config.line_searches, "maxfun": config.evaluations, "maxcor": _REMEMBERED}
    options = {**limits, "ftol": 1e-9, "gtol": 1e-6}
    with contextlib.suppress(_Enough):  # L-BFGS-B looks at maxfun between line searches only
        minimize(objective, objective.best, jac=True, method="L-BFGS-B", options=options)
    found, problem = objective.policy, objective.problem
    vector_to_parameters(torch.from_numpy(objective.best), found.parameters())
    with torch.no_grad():
        states, _, costs = problem.prediction(found)
    size = _SPREAD_PARTICLES, states.width
    normal = torch.randn(size, generator=generator, dtype=torch.float64)
    return Candidate(found, problem, states, costs, normal)


class _Enough(Exception):  # noqa: N818  no error
    """All evaluations are spent."""


class Objective:
    """The expected cost and its gradient as an optimiser sees them; keeps the best point.

    Where the model has no finite answer the value is larger than all that were met, and flat: a
    line search that has stepped there takes a shorter step.
    """

    def __init__(
        self, problem: Problem, policy: GPMean, config: PilcoConfig, report: Report
    ) -> None:
        self.policy = policy
        self.count = 0
        """evaluations done"""
        self.best = parameters_to_vector(policy.parameters()).detach().numpy().copy()
        """parameters of the lowest cost so far"""
        self.problem, self._report = problem, report
        self._most = config.evaluations
        self._lowest, self._highest = math.inf, 0.0

    def value(self, policy: GPMean) -> float:
        """The cost of a policy [-]; not finite where the model has no answer."""
        return self._evaluate(parameters_to_vector(policy.parameters()).detach().numpy().copy())[0]

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """The cost [-] and its gradient.

        Raises:
            _Enough: there shall be no more evaluations.
        """
        if self.count >= self._most:
            raise _Enough
        value, gradient = self._evaluate(x)
        if not math.isfinite(value):
            return 2.0 * self._highest + 1.0, np.zeros_like(x)
        return value, gradient

    def _evaluate(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """The cost and its gradient, or NaN where either is not finite."""
        self.count += 1
        vector_to_parameters(torch.tensor(x), self.policy.parameters())
        value, gradient = math.nan, np.full_like(x, math.nan)
        try:
            total = self.problem.prediction(self.policy)[2].sum()
            slopes = torch.autograd.grad(total, list(self.policy.parameters()))
        except torch.linalg.LinAlgError:
            pass  # a covariance that is none: the step was too long
        else:
            gradient = parameters_to_vector(slopes).numpy()
            value = float(total.detach()) if np.isfinite(gradient).all() else math.nan
        if math.isfinite(value):
            self._highest = max(self._highest, abs(value))
            if value < self._lowest:
                self._lowest, self.best = value, x.copy()
        norm = float(np.linalg.norm(gradient))
        self._report(self.count, self._most, {"policy/cost": value, "policy/gradient_norm": norm})
        return value, gradient
