"""State estimates that a policy acts on: of states measured in part, and with past inputs.

An estimator follows the protocol `mcpilco.typing.Estimator`: `begin`, then in each step `observe`
and `after`. `mcpilco.sensing.delay` has those for actuators that answer late; `Chain` joins two.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.sensing.motion import Motion
from mcpilco.task import TaskSpec
from mcpilco.typing import Estimator

State = Float[Tensor, "*b X"]
"""of a batch, each entry in its unit"""
Measured = Float[Tensor, "*b Y"]
"""likewise"""
Inputs = Float[Tensor, "*b U"]
"""likewise"""
Memory = Float[Tensor, "*b M"]
"""of an estimator"""
Begun = Bool[Tensor, "*b"] | None
"""which of a batch begin an episode; None: none"""


@dataclass(frozen=True)
class LinearEstimator:
    """Corrects what it expects by what is measured, and moves on.

        x^ = x- + K_t (y - C x-),    x- of the next step = A x^

    Its memory is x- and the number t of measurements so far, in one row [x-, t]. All is
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

    def begin(self, states: Float[Tensor, "*b n"]) -> Memory:
        """The memory before the first measurement of an episode, wherever it starts."""
        memory = torch.cat([self.start, self.start.new_zeros(1)])
        return memory.expand(*states.shape[:-1], len(memory))

    def observe(
        self, measured: Measured, memory: Memory, begun: Begun = None
    ) -> tuple[State, Memory]:
        """The estimate of the state, and the memory for the next measurement."""
        if begun is not None:
            memory = torch.where(begun[..., None], self.begin(measured), memory)
        expected, count = memory[..., :-1], memory[..., -1:]
        K = self.gains[count[..., 0].long().clamp_max(len(self.gains) - 1)]
        estimate = expected + _product(K, measured - _product(self.C, expected))
        return estimate, torch.cat([_product(self.A, estimate), count + 1], -1)

    def after(self, memory: Memory, inputs: Inputs) -> Memory:
        """The same memory: the motion knows no inputs."""
        return memory


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
    """The Kalman filter of a motion: the best of all linear estimates, if the motion is linear."""
    arrays = motion.A, motion.C, motion.gains(), motion.start_mean
    return LinearEstimator(*map(torch.from_numpy, arrays))


def differences(task: TaskSpec, low_pass: float = 0.0) -> LinearEstimator:
    """Takes measurements as they are, and velocities from their differences, filtered.

        v^ = low_pass v^_before + (1 - low_pass) (y - y_before) / dt

    A difference is the velocity of half a step ago, and the filter delays it more. Before there are
    two measurements, a velocity is that of the start's mean.

    The share `low_pass` of the estimate before is kept, in [0, 1).
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
class PastInputs:
    """Appends the last inputs to the state, newest first; before an episode they were 0."""

    inputs: int
    """U"""
    count: int
    """of steps that are kept"""

    def begin(self, states: State) -> Memory:
        """The inputs before an episode: zeros."""
        return states.new_zeros(*states.shape[:-1], self.inputs * self.count)

    def observe(
        self, measured: State, memory: Memory, begun: Begun = None
    ) -> tuple[Float[Tensor, "*b X_plus_M"], Memory]:
        """The state with the last inputs behind it."""
        if begun is not None:
            memory = torch.where(begun[..., None], 0.0, memory)
        return torch.cat([measured, memory], -1), memory

    def after(self, memory: Memory, inputs: Inputs) -> Memory:
        """The last inputs, of which the oldest gives way to a new one."""
        return torch.cat([inputs, memory], -1)[..., : memory.shape[-1]]


@dataclass(frozen=True, eq=False)
class Chain:
    """Two estimators in a row: the second one takes the first one's estimates as measurements."""

    first: Estimator
    second: Estimator

    def begin(self, states: Float[Tensor, "*b n"]) -> tuple[Any, Any]:
        """The memories of both."""
        return self.first.begin(states), self.second.begin(states)

    def observe(
        self, measured: Measured, memory: tuple[Any, Any], begun: Begun = None
    ) -> tuple[State, tuple[Any, Any]]:
        """The second one's estimate, and both memories."""
        estimate, first = self.first.observe(measured, memory[0], begun)
        estimate, second = self.second.observe(estimate, memory[1], begun)
        return estimate, (first, second)

    def after(self, memory: tuple[Any, Any], inputs: Inputs) -> tuple[Any, Any]:
        """The memories of both."""
        return self.first.after(memory[0], inputs), self.second.after(memory[1], inputs)


def chained(*estimators: Estimator | None) -> Estimator | None:
    """One estimator for those that are there, in their order; None where none is."""
    present = [one for one in estimators if one is not None]
    return functools.reduce(Chain, present) if present else None


@dataclass(frozen=True, eq=False)
class Observer:
    """A noisy sensor and the estimator behind it, for the particles of a rollout."""

    estimator: Estimator
    noise_std: Float[Tensor, " Y"]
    """of each measurement, in its unit"""
    C: Float[Tensor, "Y X"] | None = None
    """from a state to its measurement; None: all states are measured"""

    @property
    def noise_dim(self) -> int:
        """Y: one standard normal number for each measurement."""
        return len(self.noise_std)

    def measured(self, states: State, noise: Measured) -> Measured:
        """Noisy measurements of the states."""
        seen = states if self.C is None else states @ self.C.T
        return seen + self.noise_std * noise
