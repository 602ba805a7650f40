"""A plant's equations of motion as the mean of the model, its parameters learned from the data.

    x' = F(x, u; theta) + B g(x, u),    log theta ~ N(log theta_0, s^2),    g ~ GP(0, k)

F is the plant's own next state. The Gaussian processes learn the residual of the changes that are
predicted, and `B` integrates it: where the residual is zero, the model is the plant, positions
included. Each particle keeps one sample of the parameters over the horizon, and its residual is
conditioned on the data given that sample: near the data all particles agree, whatever their
parameters.

Weights of forces that the plant's equations lack (`mcpilco.dynamics.missing_forces`) are further
parameters, learned and sampled as the others are.

A `Spread` says which plants the policy must hold for, beside the one that the data are of. What a
particle draws of it moves its equations alone: its residual is that of the data's plant.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from jaxtyping import Float
from scipy.linalg import block_diag
from torch import Tensor

from mcpilco.data import Transitions
from mcpilco.dynamics.dynamics import GPDynamics, Increment
from mcpilco.dynamics.missing_forces import MissingForces
from mcpilco.gp import Posterior
from mcpilco.plant import (
    Plant,
    PlantStep,
    Program,
    Spread,
    free_parameters,
    numbers_of,
    step_of,
)
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

logger = logging.getLogger(__name__)

STEP = 1e-3
"""relative difference of a parameter by which derivatives are taken"""
ITERATIONS = 12
"""of Gauss and Newton, at most"""
SETTLED = 1e-4
"""change of the logarithms below which they end [-]"""
FARTHEST = 1.0
"""that a weight of a missing force goes in one of them, in prior standard deviations [-]"""
MEAN, COVARIANCE = "physics.mean", "physics.covariance"
ROOTS, FASTEST = "physics.roots", "physics.fastest"
"""arrays of what was learned, in a file"""


@dataclass(frozen=True)
class Parameters:
    """The distribution of a plant's uncertain parameters, and of forces that it lacks."""

    mean: Float[np.ndarray, " K"]
    """log(theta / theta_0), then weights over their prior standard deviations [-]"""
    covariance: Float[np.ndarray, "K K"]
    """[-]"""

    @property
    def root(self) -> Float[np.ndarray, "K K"]:
        """R of the covariance R R'.

        Where data without noise know a number to its last digits, rounding leaves no Cholesky
        factor.
        """
        try:
            return np.linalg.cholesky(self.covariance)
        except np.linalg.LinAlgError:
            sizes, axes = np.linalg.eigh(self.covariance)
            return axes * np.sqrt(np.maximum(sizes, 0.0))


class PhysicsMean:
    """F(x, u; theta) of one sampling interval, and what is believed of theta."""

    def __init__(
        self,
        plant: Plant,
        task: TaskSpec,
        increment: Increment,
        memory: int = 0,
        uncertainty: float | Float[np.ndarray, "K K"] = 0.2,
        longest: float = 0.025,
        missing: bool = False,
        spread: Spread | None = None,
    ) -> None:
        """A mean that has seen no data.

        Args:
            plant: with the states and inputs of the task; its parameters are where the prior is.
            task: names states and inputs.
            increment: which changes the residual is of.
            memory: how many past commands a state holds.
            uncertainty: prior standard deviation of the logarithm of each uncertain parameter, or
                the covariance of all these; 0 trusts them.
            longest: Runge-Kutta step [s].
            missing: whether forces are learned that the equations lack, the kernel part `gip`.
            spread: the plants that particles draw from, around this one; None: this one alone.

        Raises:
            InputError: the plant does not fit the task, or has what a program cannot say.
        """
        self.plant = plant
        self.increment = increment
        self.spread = spread
        self._step_of = partial(step_of, task=task, longest=longest, memory=memory)
        self.missing = MissingForces(plant, task) if missing else None
        self._build()
        self.free = free_parameters(plant) if np.any(uncertainty) else ()
        self.names = tuple(plant.parameters[i].name for i in self.free)
        given = np.asarray(uncertainty, dtype=float)
        self._covariance = given if given.ndim else given**2 * np.eye(len(self.free))
        self.belief = self.prior

    @property
    def prior(self) -> Parameters:
        """The prior distribution; of missing forces, given the sizes of their weights."""
        weights = 0 if self.missing is None else len(self.missing.scales)
        covariance = block_diag(self._covariance, np.eye(weights))
        return Parameters(np.zeros(len(covariance)), covariance)

    def weakened(self, share: float) -> PhysicsMean:
        """The same with the effects of the plant on their way, see `Plant.weakened`."""
        weaker = copy.copy(self)
        weaker.plant = self.plant.weakened(share)
        weaker.spread = None  # particles draw their plants where the way ends
        weaker._build()
        return weaker

    def _build(self) -> None:
        """Make the step of the plant as it is, with the missing forces that are known."""
        forces = None if self.missing is None else self.missing.forces
        spread = self.spread
        drawn = spread.rows(_normal_points(spread.dimensions)) if spread else None
        self.step: PlantStep = self._step_of(self._known, missing=forces, drawn=drawn)

    @property
    def _known(self) -> Plant:
        """The plant whose parameters the program's numbers are of."""
        return self.plant if self.spread is None else self.spread.plant

    @property
    def values(self) -> dict[str, float]:
        """Expected value of each uncertain parameter, in its unit."""
        (row,) = self._parameters(self.belief.mean[None])
        return {self.plant.parameters[i].name: float(row[i]) for i in self.free}

    def drawn(self, points: Float[np.ndarray, "S D"]) -> Float[Tensor, "S L"]:
        """The arguments of the program for plants that standard normal numbers choose."""
        K = len(self.belief.mean)
        values = self.belief.mean + points[:, :K] @ self.belief.root.T
        return self.numbers(values, self.spread.rows(points[:, K:]) if self.spread else None)

    def numbers(
        self, values: Float[np.ndarray, "S K"], plants: Float[np.ndarray, "S P"] | None = None
    ) -> Float[Tensor, "S L"]:
        """The arguments of the program for parameters that are given as in `Parameters.mean`.

        They are relative to those of the plant, or of each of some `plants` of the spread.
        """
        own = numbers_of(self._known, self.step.slots, self._parameters(values, plants))
        if self.missing is not None:
            own = np.concatenate([own, values[:, len(self.free) :] * self.missing.scales], 1)
        return torch.from_numpy(own)

    def _parameters(
        self, values: Float[np.ndarray, "S K"], plants: Float[np.ndarray, "S P"] | None = None
    ) -> Float[np.ndarray, "S P"]:
        centre = self.plant.nominal if self.spread is None else self.spread.expected({})
        rows = np.tile(centre, (len(values), 1)) if plants is None else plants.copy()
        rows[:, list(self.free)] *= np.exp(values[:, : len(self.free)])
        return rows

    @torch.no_grad()
    def changes(
        self, rows: Transitions, values: Float[np.ndarray, "S K"]
    ) -> Float[np.ndarray, "S N E"]:
        """The changes of the predicted states by the equations F, for S sets of parameters."""
        known = torch.from_numpy(np.concatenate([rows.states, rows.inputs], 1))
        own = self.numbers(values)
        S, N = len(own), len(known)
        given = torch.cat([known.expand(S, -1, -1), own[:, None].expand(-1, N, -1)], -1)
        predicted = list(self.increment.predicted)
        following = self.step.program(given).numpy()[..., predicted]
        return following - rows.states[:, predicted]

    def sensitivities(self, rows: Transitions) -> Float[np.ndarray, "E N K"]:
        """Derivatives of these changes by the parameters, as in `Parameters.mean`, where it is."""
        by_logs = self._by_logs(rows)
        if self.missing is None or self.missing.forces is None:
            return by_logs
        return np.concatenate([by_logs, self._by_weights(rows) * self.missing.scales], -1)

    def _by_logs(self, rows: Transitions) -> Float[np.ndarray, "E N K"]:
        """Derivatives of these changes by the logarithms of the plant's parameters."""
        if not self.free:
            return np.zeros((len(self.increment.predicted), len(rows), 0))
        steps = STEP * np.eye(len(self.free), len(self.belief.mean))
        values = np.concatenate([self.belief.mean + steps, self.belief.mean - steps])
        up, down = np.split(self.changes(rows, values), 2)
        return ((up - down) / (2 * STEP)).transpose(2, 1, 0)

    def _by_weights(self, rows: Transitions) -> Float[np.ndarray, "E N W"]:
        """Derivatives of these changes by the weights of the missing forces."""
        known = torch.from_numpy(np.concatenate([rows.states, rows.inputs], 1))
        own = self.numbers(self.belief.mean[None]).expand(len(rows), -1).clone()
        with torch.enable_grad():
            following = self.step.program(torch.cat([known, own.requires_grad_()], -1))
        slots, outputs = len(self.step.slots), self.increment.predicted
        slopes = [
            torch.autograd.grad(following[:, i].sum(), own, retain_graph=True)[0] for i in outputs
        ]
        return torch.stack(slopes)[..., slots:].numpy()

    def residuals(self, rows: Transitions) -> Float[np.ndarray, "N E"]:
        """The measured changes without those of the expected parameters."""
        (expected,) = self.changes(rows, self.belief.mean[None])
        return self.increment.targets(rows) - expected

    def identify(self, rows: Transitions, noise_floor: float) -> None:
        """Fit the parameters to data as if what they leave were white noise, of unknown size.

        Missing forces are those of highest evidence, by what the plant's parameters alone leave.

        The noise has a standard deviation of `noise_floor` at least, in the unit of each change.
        """
        if self.missing is not None:
            self._forget(self.missing)
        self.belief = self.prior
        self._fit(rows, noise_floor)
        if self.missing is not None:
            self._find_missing(self.missing, rows, noise_floor)

    def _find_missing(self, missing: MissingForces, rows: Transitions, noise_floor: float) -> None:
        """Fit the forces that the equations lack too; none, where they bring nothing."""
        known, left = self.belief, self.residuals(rows)
        predicted = list(self.increment.predicted)
        columns = [predicted.index(i) for i in missing.order[0][1::2]]
        tables = self._known.tables(self._parameters(known.mean[None]))
        start = missing.fit(rows, left[:, columns], tables, noise_floor)
        if not len(start):
            return
        self._build()
        self.belief = Parameters(np.concatenate([known.mean, start]), self.prior.covariance)
        self._fit(rows, noise_floor)
        if not np.square(self.residuals(rows)).mean(0).prod() <= np.square(left).mean(0).prod():
            logger.warning("Forces found to be missing predict no better; they are left out.")
            self._forget(missing)
            self.belief = known

    def _forget(self, missing: MissingForces) -> None:
        missing.forget()
        self._build()

    def _fit(self, rows: Transitions, noise_floor: float) -> None:
        for _ in range(ITERATIONS if len(self.belief.mean) else 0):
            left = self.residuals(rows)
            std = np.maximum(np.sqrt((left**2).mean(0)), noise_floor)
            J = self.sensitivities(rows) / std[:, None, None]
            if self._improve(J, left.T / std[:, None]) < SETTLED:
                return

    def refine(self, rows: Transitions, posterior: Posterior) -> None:
        """The same where the residual is a Gaussian process: what both explain is left open."""
        for _ in range(2 if len(self.belief.mean) else 0):
            white = posterior.L_inv.numpy()
            J = white @ self.sensitivities(rows)
            self._improve(J, (white @ self.residuals(rows).T[..., None])[..., 0])

    def _improve(self, J: Float[np.ndarray, "E N K"], left: Float[np.ndarray, "E N"]) -> float:
        """One step of Gauss and Newton; returns the largest change. Rows have unit noise."""
        prior = self.prior.covariance
        std, known = np.sqrt(np.diag(prior)), np.linalg.inv(prior)
        slope = np.einsum("enk,en->k", J, left) - known @ self.belief.mean
        covariance = np.linalg.inv(known + np.einsum("enk,enl->kl", J, J))
        # within three prior standard deviations a parameter has a meaning, and the model a value
        most = np.where(np.arange(len(std)) < len(self.free), 3.0 * std, np.inf)
        step = covariance @ slope
        if len(step) > len(self.free):  # accelerations are no linear functions of inertias
            step *= min(1.0, FARTHEST / max(np.abs(step[len(self.free) :]).max(), SETTLED))
        mean = np.clip(self.belief.mean + step, -most, most)
        change = float(np.abs(mean - self.belief.mean).max())
        self.belief = Parameters(mean, (covariance + covariance.T) / 2)
        return change

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Everything learned, as named arrays: what `load_arrays` reads."""
        own = {MEAN: self.belief.mean, COVARIANCE: self.belief.covariance}
        if self.missing is None:
            return own
        return own | {ROOTS: self.missing.roots, FASTEST: self.missing.most}

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the arrays of `to_arrays`.

        Raises:
            InputError: an array is missing, of another shape, or not finite.
        """
        if self.missing is not None:
            J, F = self.missing.roots.shape
            self._require(arrays, {ROOTS: (J, F), FASTEST: (J,)})
            self.missing.roots, self.missing.most = arrays[ROOTS], arrays[FASTEST]
            self._build()
        K = len(self.prior.mean)
        self._require(arrays, {MEAN: (K,), COVARIANCE: (K, K)})
        self.belief = Parameters(arrays[MEAN], arrays[COVARIANCE])

    @staticmethod
    def _require(arrays: Mapping[str, np.ndarray], shapes: Mapping[str, tuple[int, ...]]) -> None:
        found = {name: arrays[name].shape for name in shapes if name in arrays}
        if found != shapes or not all(np.isfinite(arrays[name]).all() for name in shapes):
            raise InputError(
                f"Saved physics must have finite arrays of shapes {shapes}, got {found}; name the "
                "plant that it was learned with."
            )


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
        K = len(physics.belief.mean)
        normal = _normal_points(K + (physics.spread.dimensions if physics.spread else 0))
        spread = normal[:, :K] @ physics.belief.root.T
        self._numbers = physics.drawn(normal)
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
