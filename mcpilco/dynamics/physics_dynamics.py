"""Particles in a plant with uncertain parameters and a residual, see `mcpilco.dynamics.physics`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.data import Transitions
from mcpilco.dynamics.dynamics import GPDynamics
from mcpilco.plant import Program

if TYPE_CHECKING:
    from mcpilco.dynamics.physics import PhysicsMean

SAMPLES = 512
"""of the parameters, that particles are given at random"""


class PhysicsDynamics:
    """A plant with uncertain parameters, and a residual: a distribution over models."""

    def __init__(self, physics: PhysicsMean, model: GPDynamics, rows: Transitions) -> None:
        """A model of the next state, given data.

        `model` is of the residual, at the expected parameters; its A x + C u is not used.
        """
        self.model = model
        self.physics, self._rows = physics, rows
        self.program = physics.step.program
        normal = _normal_points(len(physics.belief.mean))
        spread = normal @ np.linalg.cholesky(physics.belief.covariance).T
        self._numbers = physics.numbers(physics.belief.mean + spread)
        # given theta, alpha = (K + s^2 I)^-1 (y - F(theta)): linear in theta near its mean
        L_inv = model.posterior.L_inv.numpy()
        solved = L_inv.swapaxes(1, 2) @ (L_inv @ physics.sensitivities(rows))
        self._weights = torch.from_numpy(-solved @ spread.T)

    @property
    def noise_dim(self) -> int:
        """E: one standard normal number for each predicted change."""
        return self.model.noise_dim

    def weakened(self, share: float) -> PhysicsDynamics:
        """The same where the effects of the plant are on their way, see `Plant.weakened`."""
        return PhysicsDynamics(self.physics.weakened(share), self.model, self._rows)

    def draw(self, particles: int, generator: torch.Generator) -> PhysicsDraw:
        """Dynamics in which each particle has parameters of its own."""
        chosen = torch.randint(len(self._numbers), (particles,), generator=generator)
        return PhysicsDraw(
            self.model, self.program, self._numbers[chosen], self._weights[..., chosen]
        )


@dataclass(frozen=True, eq=False)
class PhysicsDraw:
    """The model of particles that have their parameters."""

    model: GPDynamics
    """of the residual, at the expected parameters"""
    program: Program
    """F"""
    numbers: Float[Tensor, "P L"]
    """each particle's own, for the program"""
    weights: Float[Tensor, "E N P"]
    """of the samples in each particle's residual, beyond those at the expected parameters"""

    @property
    def noise_dim(self) -> int:
        """E: one standard normal number for each predicted change."""
        return self.model.noise_dim

    def step(
        self,
        states: Float[Tensor, "P X"],
        inputs: Float[Tensor, "P U"],
        noise: Float[Tensor, "P E"],
    ) -> Float[Tensor, "P X"]:
        """The next states of the particles, reparametrised by standard normal numbers."""
        posterior, at = self.model.posterior, self.model.regressors(states, inputs)
        mean, variance = posterior.mean_and_variance(at)
        own = (posterior.kernel(posterior.X, at[None]) * self.weights).sum(-2).mT
        drift = self.program(torch.cat([states, inputs, self.numbers], -1))
        return self.model.moved(states, drift, mean + own + variance.sqrt() * noise)


def _normal_points(dimensions: int) -> Float[np.ndarray, "S K"]:
    """Evenly spread points of the standard normal distribution."""
    if dimensions == 0:
        return np.zeros((1, 0))
    engine = torch.quasirandom.SobolEngine(dimensions, scramble=True, seed=0)
    points = engine.draw(SAMPLES, dtype=torch.float64).clamp(1e-6, 1 - 1e-6)
    return (2.0**0.5 * torch.erfinv(2.0 * points - 1.0)).numpy()
