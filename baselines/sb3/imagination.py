"""Transitions of particles in the model of MC-PILCO: what it says would be recorded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.agent import MCPILCO
from mcpilco.data import Transitions
from mcpilco.policies import RewardCost
from mcpilco.search import Problem, rollout
from mcpilco.typing import InputError


@dataclass(frozen=True)
class Imagined(Transitions):
    """N transitions of particles, and their rewards."""

    rewards: Float[np.ndarray, " N"]
    """at the end of each step [-]"""


@dataclass(frozen=True)
class Perturbed:
    """A policy that particles follow with noise of their own, after random inputs of their own."""

    source: MCPILCO
    """whose policy it is"""
    begin: Float[Tensor, " P"]
    """step at which each particle begins to follow it; before, inputs are uniform"""
    std: Float[Tensor, " P"]
    """of the noise of each, relative to half the inputs' range [-]"""
    generator: torch.Generator
    """of all noise"""

    def __call__(
        self, states: Float[Tensor, "P X"], dropout: Any = None, step: int = 0
    ) -> Float[Tensor, "P U"]:
        """The inputs of all particles, in the env's unit."""
        policy = self.source.policy
        centre, half_range = policy.squash.centre, policy.squash.half_range
        wanted = (policy(states) - centre) / half_range
        normal = torch.randn(wanted.shape, generator=self.generator, dtype=wanted.dtype)
        uniform = 2.0 * torch.rand(wanted.shape, generator=self.generator, dtype=wanted.dtype) - 1
        noisy = (wanted + self.std[:, None] * normal).clamp(-1.0, 1.0)
        follows = (step >= self.begin)[:, None]
        return centre + half_range * torch.where(follows, noisy, uniform)


class Imagination:
    """Rollouts in the model of an agent, conditioned on all its data; they start as episodes do.

    Rewards are 1 - cost, as those of this package's envs; where the cost was learned from rewards,
    they are those that it stands for.
    """

    def __init__(self, source: MCPILCO) -> None:
        """The model of an agent.

        Raises:
            InputError: it has done none, or measures a part of its states.
            NotPositiveDefiniteError: the model cannot be conditioned on the data.
        """
        data, task = source.transitions, source.task
        if data is None or not source.trials:
            raise InputError("A warm start needs an agent that has done a trial, got one without.")
        if source.perception is not None or task.cost is None:
            raise InputError(
                "A warm start needs a model of states that are all measured, got an agent that "
                "estimates some of them."
            )
        if source.model.memory:
            raise InputError(
                "A warm start needs a model whose states hold no past inputs, got model.memory "
                f"{source.model.memory}."
            )
        self._cost = task.cost
        self._problem = Problem(
            dynamics=source.model.dynamics(data),
            cost=task.cost,
            start_mean=torch.tensor(task.start_mean, dtype=torch.float64),
            start_std=torch.tensor(task.start_std, dtype=torch.float64),
            horizon=source.horizon,
            reference_cost=source.reference_cost,
            rollout=rollout,
        )

    def rollouts(self, policy: Any, count: int, generator: torch.Generator) -> Imagined:
        """Transitions of so many particles that follow a policy.

        Raises:
            InputError: the model predicts nothing finite.
        """
        with torch.no_grad():
            particles = self._problem.particles(policy, count, generator)
            costs = self._problem.costs(particles).numpy()
        states, inputs = particles.states.numpy(), particles.inputs.numpy()
        rows = states[:-1], inputs, states[1:], self._rewards(costs)
        flat = [array.reshape(costs.size, *array.shape[2:]) for array in rows]
        if not all(np.isfinite(array).all() for array in flat):
            raise InputError("The model predicts nothing finite; let its agent learn a trial more.")
        return Imagined(*flat)

    def _rewards(self, costs: Float[np.ndarray, "T P"]) -> Float[np.ndarray, "T P"]:
        if isinstance(self._cost, RewardCost):
            return self._cost.rewards.max() - costs * np.ptp(self._cost.rewards)
        return 1.0 - costs
