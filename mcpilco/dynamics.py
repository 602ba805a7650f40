"""Models of the next state: what the GPs predict, and how a state follows from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.data import Transitions
from mcpilco.features import AngleAugmentation
from mcpilco.gp import Posterior
from mcpilco.task import TaskSpec


@dataclass(frozen=True)
class Increment:
    """Which changes are predicted, and the law that makes a state of them: x' = A x + B delta."""

    predicted: tuple[int, ...]
    """states whose change a GP predicts: delta_e = x'[predicted[e]] - x[predicted[e]]"""
    A: Float[np.ndarray, "X X"]
    """from the state to the next one"""
    B: Float[np.ndarray, "X E"]
    """from the predicted changes to the next state"""

    def targets(self, transitions: Transitions) -> Float[np.ndarray, "N E"]:
        """The measured changes that the GPs learn from."""
        return (transitions.next_states - transitions.states)[:, list(self.predicted)]


def full_state(task: TaskSpec) -> Increment:
    """A GP for the change of each state.

    Reference: thesis eq. (5.6).
    """
    width = len(task.state_names)
    return Increment(tuple(range(width)), np.eye(width), np.eye(width))


def speed_integration(task: TaskSpec) -> Increment:
    """GPs for the changes of the velocities; positions follow, at constant acceleration.

        q' = q + dt dq + dt / 2 (dq' - dq)

    A state that is neither a position nor a velocity keeps a GP of its own.

    Reference: thesis eq. (5.9).
    """
    width = len(task.state_names)
    positions = {position for position, _ in task.velocities}
    predicted = tuple(i for i in range(width) if i not in positions)
    A = np.eye(width)
    B = np.zeros((width, len(predicted)))
    for e, i in enumerate(predicted):
        B[i, e] = 1.0
    for position, velocity in task.velocities:
        A[position, velocity] = task.dt
        B[position, predicted.index(velocity)] = task.dt / 2
    return Increment(predicted, A, B)


class GPDynamics:
    """One sampled step of a GP posterior.

    Only the latent function's variance is sampled, not the learned measurement noise.

    Differs: a particle that would leave the plausible range stays where it is, for the polynomial
    kernel extrapolates without bound.
    """

    def __init__(
        self,
        posterior: Posterior,
        augmentation: AngleAugmentation,
        increment: Increment,
        bounds: Float[np.ndarray, " E"],
    ) -> None:
        """A model of the next state.

        Args:
            posterior: of the E predicted changes, given regressors [z, u].
            augmentation: from the state to z.
            increment: from changes to states.
            bounds: largest plausible magnitude of each predicted state, in its unit.
        """
        self.posterior = posterior
        self.augmentation = augmentation
        self.increment = increment
        self.predicted = list(increment.predicted)
        self.A = torch.from_numpy(increment.A)
        self.B = torch.from_numpy(increment.B)
        self.bounds = torch.from_numpy(bounds)

    @property
    def noise_dim(self) -> int:
        """E: one standard normal number for each predicted change."""
        return len(self.predicted)

    def step(
        self,
        states: Float[Tensor, "*b X"],
        inputs: Float[Tensor, "*b U"],
        noise: Float[Tensor, "*b E"],
    ) -> Float[Tensor, "*b X"]:
        """The next states, reparametrised by standard normal numbers.

        Reference: thesis eqs. (5.3) to (5.7) and section 5.4.2.
        """
        regressors = self.augmentation.regressors(states, inputs)
        mean, variance = self.posterior.mean_and_variance(regressors)
        return self.advance(states, mean + variance.sqrt() * noise)

    def advance(
        self, states: Float[Tensor, "*b X"], delta: Float[Tensor, "*b E"]
    ) -> Float[Tensor, "*b X"]:
        """The next states, given the predicted changes; a state stays rather than leave its bounds.

        Args:
            states: now, in their units.
            delta: change of each predicted state, in its unit.
        """
        following = states @ self.A.T + delta @ self.B.T
        inside = (following[..., self.predicted].abs() <= self.bounds).all(-1, keepdim=True)
        return torch.where(inside, following, states)
