"""Models of the next state: what the GPs predict, and how a state follows from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.data import Transitions
from mcpilco.dynamics.features import AngleAugmentation, Inputs, States
from mcpilco.gp import Posterior
from mcpilco.plant import Program
from mcpilco.task import TaskSpec


@dataclass(frozen=True)
class Increment:
    """The predicted entries of the state, and the next state: x' = A x + B delta + C u."""

    predicted: tuple[int, ...]
    """states whose change a GP predicts: delta_e = x'[predicted[e]] - x[predicted[e]]"""
    A: Float[np.ndarray, "X X"]
    """from the state to the next one"""
    B: Float[np.ndarray, "X E"]
    """from the predicted changes to the next state"""
    C: Float[np.ndarray, "X U"]
    """from the inputs to the next state: what it remembers of them"""

    def targets(self, transitions: Transitions) -> Float[np.ndarray, "N E"]:
        """The measured changes that the GPs learn from."""
        return (transitions.next_states - transitions.states)[:, list(self.predicted)]

    def remembering(self, inputs: int, memory: int) -> Increment:
        """The same of states behind which the last commands stand, newest first."""
        X, E, more = len(self.A), self.B.shape[1], inputs * memory
        A, B, C = (np.zeros((X + more, width)) for width in (X + more, E, inputs))
        A[:X, :X], B[:X], C[:X] = self.A, self.B, self.C
        if memory:
            C[X : X + inputs] = np.eye(inputs)
            A[X + inputs :, X:-inputs] = np.eye(more - inputs)
        return Increment(self.predicted, A, B, C)


def full_state(task: TaskSpec) -> Increment:
    """A GP for the change of each state.

    Reference: thesis eq. (5.6).
    """
    width, inputs = len(task.state_names), len(task.input_names)
    return Increment(tuple(range(width)), np.eye(width), np.eye(width), np.zeros((width, inputs)))


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
    return Increment(predicted, A, B, np.zeros((width, len(task.input_names))))


def regressors(
    augmentation: AngleAugmentation, features: Program | None, states: States, inputs: Inputs
) -> Float[Tensor, "*b D"]:
    """Regressors of the GPs: [z, u], and features of both where there are any."""
    plain = augmentation.regressors(states, inputs)
    if features is None:
        return plain
    return torch.cat([plain, features(torch.cat([states, inputs], -1))], -1)


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
        features: Program | None = None,
    ) -> None:
        """A model of the next state.

        Bounds are the largest plausible magnitude of each predicted state, in its unit; features
        are further regressors, of [state, inputs].
        """
        self.posterior = posterior
        self.augmentation = augmentation
        self.increment = increment
        self.predicted = list(increment.predicted)
        self.A = torch.from_numpy(increment.A)
        self.B = torch.from_numpy(increment.B)
        self.C = torch.from_numpy(increment.C)
        self.features = features
        self.bounds = torch.from_numpy(bounds)

    @property
    def noise_dim(self) -> int:
        """E: one standard normal number for each predicted change."""
        return len(self.predicted)

    def step(self, states: States, inputs: Inputs, noise: Float[Tensor, "*b E"]) -> States:
        """The next states, reparametrised by standard normal numbers.

        Reference: thesis eqs. (5.3) to (5.7) and section 5.4.2.
        """
        mean, variance = self.posterior.mean_and_variance(self.regressors(states, inputs))
        return self.advance(states, inputs, mean + variance.sqrt() * noise)

    def expected(
        self, states: Float[Tensor, "*b P X"], inputs: Float[Tensor, "*b P U"]
    ) -> Float[Tensor, "*b P X"]:
        """The next states, given the changes that the posterior expects."""
        mean = self.posterior.mean(self.regressors(states, inputs))
        return self.advance(states, inputs, mean)

    def regressors(self, states: States, inputs: Inputs) -> Float[Tensor, "*b D"]:
        """The regressors at which the posterior is evaluated."""
        return regressors(self.augmentation, self.features, states, inputs)

    def advance(self, states: States, inputs: Inputs, delta: Float[Tensor, "*b E"]) -> States:
        """The next states by predicted changes; a state stays rather than leave its bounds."""
        return self.moved(states, states @ self.A.T + inputs @ self.C.T, delta)

    def moved(self, states: States, drift: States, delta: Float[Tensor, "*b E"]) -> States:
        """drift + B delta, or the state itself where that is out of bounds."""
        following = drift + delta @ self.B.T
        inside = (following[..., self.predicted].abs() <= self.bounds).all(-1, keepdim=True)
        return torch.where(inside, following, states)
