"""States from the measurements so far: what a policy acts on where a state is measured in part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.sensing.motion import Motion
from mcpilco.task import TaskSpec


@dataclass(frozen=True)
class LinearEstimator:
    """Corrects what it expects by what is measured, and moves on.

        x^ = x- + K_t (y - C x-),    x- of the next step = A x^

    It remembers x- and the number t of measurements so far, in one row [x-, t]. All is
    differentiable, and works on any leading axes: a particle carries such a row with its state.

    A Kalman filter and filtered differences both have this form: `kalman` and `differences`.
    """

    A: Float[Tensor, "X X"]
    """from an estimate to what is expected of the next step"""
    C: Float[Tensor, "Y X"]
    """from a state to its measurement"""
    gains: Float[Tensor, "G X Y"]
    """K at measurement 0, 1, ...; the last one holds from there on"""
    start: Float[Tensor, " X"]
    """what is expected before any measurement, in each state's unit"""

    def begin(self, *batch: int) -> Float[Tensor, "*b M"]:
        """What is remembered before the first measurement of an episode."""
        memory = torch.cat([self.start, self.start.new_zeros(1)])
        return memory.expand(*batch, len(memory))

    def update(
        self, memory: Float[Tensor, "*b M"], measured: Float[Tensor, "*b Y"]
    ) -> tuple[Float[Tensor, "*b X"], Float[Tensor, "*b M"]]:
        """The estimate of the state, and what to remember for the next measurement."""
        expected, count = memory[..., :-1], memory[..., -1:]
        K = self.gains[count[..., 0].long().clamp_max(len(self.gains) - 1)]
        estimate = expected + _product(K, measured - _product(self.C, expected))
        return estimate, torch.cat([_product(self.A, estimate), count + 1], -1)


def _product(
    matrix: Float[Tensor, "*b n m"], vector: Float[Tensor, "*c m"]
) -> Float[Tensor, "*c n"]:
    """Matrix times vector, rounded alike for one and for many."""
    terms = (matrix * vector[..., None, :]).unbind(-1)
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total


def kalman(motion: Motion) -> LinearEstimator:
    """The Kalman filter of a motion: its estimate is the best of all linear ones, if the motion is.

    Args:
        motion: how the state moves, and how it is measured.
    """
    arrays = motion.A, motion.C, motion.gains(), motion.start_mean
    return LinearEstimator(*map(torch.from_numpy, arrays))


def differences(task: TaskSpec, low_pass: float = 0.0) -> LinearEstimator:
    """Takes measurements as they are, and velocities from their differences, filtered.

        v^ = low_pass v^_before + (1 - low_pass) (y - y_before) / dt

    A difference is the velocity of half a step ago, and the filter delays it more. Before there are
    two measurements, a velocity is that of the start's mean.

    Args:
        task: pairs of position and velocity, what is measured, the sampling time.
        low_pass: share of the estimate before that is kept, in [0, 1).
    """
    width, observed = len(task.state_names), task.measured_states
    A, C = np.eye(width), np.eye(width)[list(observed)]
    gains = np.stack([C.T, C.T])
    for position, velocity in task.velocities:
        if velocity not in observed:
            A[velocity, velocity] = low_pass
            gains[1, velocity, observed.index(position)] = (1 - low_pass) / task.dt
    start = np.array(task.start_mean)
    return LinearEstimator(*map(torch.from_numpy, (A, C, gains, start)))


@dataclass(frozen=True)
class LinearObserver:
    """A sensor and the estimator behind it: from true states to what a policy is told of them."""

    estimator: LinearEstimator
    noise_std: Float[Tensor, " Y"]
    """of each measurement, in its unit"""

    @property
    def noise_dim(self) -> int:
        """Y: one standard normal number for each measurement."""
        return len(self.noise_std)

    def begin(self, states: Float[Tensor, "*b X"]) -> Float[Tensor, "*b M"]:
        """What is remembered before the first measurement of an episode, wherever it starts."""
        return self.estimator.begin(*states.shape[:-1])

    def observe(
        self,
        states: Float[Tensor, "*b X"],
        noise: Float[Tensor, "*b Y"],
        memory: Float[Tensor, "*b M"],
    ) -> tuple[Float[Tensor, "*b X"], Float[Tensor, "*b M"]]:
        """Estimates of the states from their noisy measurements, and what to remember.

        Args:
            states: the true ones.
            noise: standard normal numbers.
            memory: of `begin`, or of the step before.
        """
        measured = states @ self.estimator.C.T + self.noise_std * noise
        return self.estimator.update(memory, measured)

    def after(
        self, memory: Float[Tensor, "*b M"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b M"]:
        """The same: the estimator knows no inputs."""
        return memory
