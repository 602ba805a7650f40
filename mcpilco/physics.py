"""A plant's equations of motion as the mean of the model, its parameters learned from the data.

    x' = F(x, u; theta) + B g(x, u),    log theta ~ N(log theta_0, s^2),    g ~ GP(0, k)

F is the plant's own next state. The Gaussian processes learn the residual of the changes that are
predicted, and `B` integrates it: where the residual is zero, the model is the plant, positions
included. Each particle keeps one sample of the parameters over the horizon, and its residual is
conditioned on the data given that sample: near the data all particles agree, whatever their
parameters.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.data import Transitions
from mcpilco.dynamics import Increment
from mcpilco.equations.step import Step, free_parameters, numbers_of, step_of
from mcpilco.gp import Posterior
from mcpilco.plant import Plant
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

STEP = 1e-3
"""relative difference of a parameter by which derivatives are taken"""
ITERATIONS = 12
"""of Gauss and Newton, at most"""
SETTLED = 1e-4
"""change of the logarithms below which they end [-]"""


@dataclass(frozen=True)
class Parameters:
    """What is believed of the logarithms of a plant's uncertain parameters, over nominal ones."""

    mean: Float[np.ndarray, " K"]
    """log(theta / theta_0) [-]"""
    covariance: Float[np.ndarray, "K K"]
    """[-]"""

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Named arrays, for a file."""
        return {"physics.mean": self.mean, "physics.covariance": self.covariance}


class PhysicsMean:
    """F(x, u; theta) of one sampling interval, and what is believed of theta."""

    def __init__(
        self,
        plant: Plant,
        task: TaskSpec,
        increment: Increment,
        memory: int = 0,
        uncertainty: float = 0.2,
        longest: float = 0.025,
    ) -> None:
        """A mean that has seen no data.

        Args:
            plant: with the states and inputs of the task; its parameters are where the prior is.
            task: names states and inputs.
            increment: which changes the residual is of.
            memory: how many past commands a state holds.
            uncertainty: prior standard deviation of the logarithm of each uncertain parameter; 0
                trusts them.
            longest: Runge-Kutta step [s].

        Raises:
            InputError: the plant does not fit the task, or has what a program cannot say.
        """
        self.plant = plant
        self.increment = increment
        self._step_of = partial(step_of, task=task, longest=longest, memory=memory)
        self.step: Step = self._step_of(plant)
        self.free = free_parameters(plant) if uncertainty > 0.0 else ()
        self.names = tuple(plant.parameters[i].name for i in self.free)
        self._prior_std = uncertainty
        self.belief = self.prior

    @property
    def prior(self) -> Parameters:
        """What is believed before any data."""
        K = len(self.free)
        return Parameters(np.zeros(K), self._prior_std**2 * np.eye(K))

    def weakened(self, share: float) -> PhysicsMean:
        """The same with the effects of the plant on their way, see `Plant.weakened`."""
        weaker = copy.copy(self)
        weaker.plant = self.plant.weakened(share)
        weaker.step = self._step_of(weaker.plant)
        return weaker

    @property
    def values(self) -> dict[str, float]:
        """Expected value of each uncertain parameter, in its unit."""
        (row,) = self._parameters(self.belief.mean[None])
        return {self.plant.parameters[i].name: float(row[i]) for i in self.free}

    def numbers(self, logs: Float[np.ndarray, "S K"]) -> Float[Tensor, "S L"]:
        """What the program needs of parameters, given as logarithms over the nominal ones."""
        return torch.from_numpy(numbers_of(self.plant, self.step.slots, self._parameters(logs)))

    def _parameters(self, logs: Float[np.ndarray, "S K"]) -> Float[np.ndarray, "S P"]:
        rows = np.tile(self.plant.nominal, (len(logs), 1))
        rows[:, list(self.free)] *= np.exp(logs)
        return rows

    @torch.no_grad()
    def changes(
        self, rows: Transitions, logs: Float[np.ndarray, "S K"]
    ) -> Float[np.ndarray, "S N E"]:
        """What F says of the predicted changes, for S sets of parameters."""
        known = torch.from_numpy(np.concatenate([rows.states, rows.inputs], 1))
        own = self.numbers(logs)
        S, N = len(own), len(known)
        given = torch.cat([known.expand(S, -1, -1), own[:, None].expand(-1, N, -1)], -1)
        predicted = list(self.increment.predicted)
        following = self.step.program(given).numpy()[..., predicted]
        return following - rows.states[:, predicted]

    def sensitivities(self, rows: Transitions) -> Float[np.ndarray, "E N K"]:
        """Derivatives of these changes by the logarithms of the parameters, where they are now."""
        if not self.free:
            return np.zeros((len(self.increment.predicted), len(rows), 0))
        steps = STEP * np.eye(len(self.free))
        logs = np.concatenate([self.belief.mean + steps, self.belief.mean - steps])
        up, down = np.split(self.changes(rows, logs), 2)
        return ((up - down) / (2 * STEP)).transpose(2, 1, 0)

    def residuals(self, rows: Transitions) -> Float[np.ndarray, "N E"]:
        """The measured changes without those of the expected parameters."""
        (expected,) = self.changes(rows, self.belief.mean[None])
        return self.increment.targets(rows) - expected

    def identify(self, rows: Transitions, noise_floor: float) -> None:
        """Fit the parameters to data as if what they leave were white noise, of unknown size.

        Args:
            rows: all data.
            noise_floor: least standard deviation of that noise, in the unit of each change.
        """
        self.belief = self.prior
        for _ in range(ITERATIONS if self.free else 0):
            left = self.residuals(rows)
            std = np.maximum(np.sqrt((left**2).mean(0)), noise_floor)
            J = self.sensitivities(rows) / std[:, None, None]
            if self._improve(J, left.T / std[:, None]) < SETTLED:
                return

    def refine(self, rows: Transitions, posterior: Posterior) -> None:
        """The same where the residual is a Gaussian process: what both explain is left open.

        Args:
            rows: the data that the posterior was conditioned on.
            posterior: whose covariance the residual has.
        """
        for _ in range(2 if self.free else 0):
            white = posterior.L_inv.numpy()
            J = white @ self.sensitivities(rows)
            self._improve(J, (white @ self.residuals(rows).T[..., None])[..., 0])

    def _improve(self, J: Float[np.ndarray, "E N K"], left: Float[np.ndarray, "E N"]) -> float:
        """One step of Gauss and Newton; returns the largest change. Rows have unit noise."""
        precision = np.eye(len(self.free)) / self._prior_std**2
        precision = precision + np.einsum("enk,enl->kl", J, J)
        slope = np.einsum("enk,en->k", J, left) - self.belief.mean / self._prior_std**2
        covariance = np.linalg.inv(precision)
        # within three prior standard deviations a parameter has a meaning, and the model a value
        most = 3.0 * self._prior_std
        mean = np.clip(self.belief.mean + covariance @ slope, -most, most)
        change = float(np.abs(mean - self.belief.mean).max())
        self.belief = Parameters(mean, (covariance + covariance.T) / 2)
        return change

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """What `Parameters.to_arrays` gave.

        Raises:
            InputError: an array is missing, of another shape, or not finite.
        """
        shapes = {name: value.shape for name, value in self.prior.to_arrays().items()}
        found = {name: arrays[name].shape for name in shapes if name in arrays}
        if found != shapes or not all(np.isfinite(arrays[name]).all() for name in shapes):
            raise InputError(
                f"Saved physics must have finite arrays of shapes {shapes}, got {found}; name the "
                "plant that it was learned with."
            )
        self.belief = Parameters(arrays["physics.mean"], arrays["physics.covariance"])
