"""The agent's model: measured transitions in, dynamics for the particles out."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.config import ModelConfig
from mcpilco.data import Transitions
from mcpilco.dynamics import GPDynamics, full_state, speed_integration
from mcpilco.features import AngleAugmentation
from mcpilco.gp import GP
from mcpilco.kernels import MPK, RBF, Kernel
from mcpilco.pathwise import PathwisePosterior
from mcpilco.sparse import subset_of_data
from mcpilco.task import TaskSpec

INTEGRATIONS = {"speed": speed_integration, "full": full_state}
"""what `ModelConfig.integration` names"""
ITERATIONS = {"lbfgs": 200, "adam": 1500}
"""most steps of each optimiser of the marginal likelihood; the authors later give Adam 1501"""


def make_kernel(config: ModelConfig, width: int, outputs: int) -> Kernel:
    """The kernel that a configuration names, for all outputs at once.

    Reference: thesis eq. (5.10) for `rbf+mpk`.
    """
    parts: dict[str, Kernel] = {
        "rbf": RBF(width, batch=(outputs,)),
        "mpk": MPK(width, config.degree, batch=(outputs,)),
    }
    first, *others = (parts[name] for name in config.kernel.split("+"))
    return sum(others, start=first)


class Model:
    """Gaussian processes for the changes of the state, refitted from scratch to new data."""

    def __init__(self, config: ModelConfig, task: TaskSpec) -> None:
        """A model that has seen nothing yet.

        Args:
            config: kernel, optimiser, what is predicted.
            task: names, angles and velocities of the state.
        """
        self.config = config
        self.task = task
        self.augmentation = AngleAugmentation(len(task.state_names), task.angles)
        self.increment = INTEGRATIONS[config.integration](task)
        self.names = tuple(task.state_names[i] for i in self.increment.predicted)
        width = self.augmentation.width + len(task.input_names)
        kernel = make_kernel(config, width, len(self.names))
        self.gp = GP(kernel, noise_floor=config.noise_floor, names=self.names)

    def rows(self, transitions: Transitions) -> tuple[Float[Tensor, "N D"], Float[Tensor, "N E"]]:
        """Regressors [z, u] and targets of the GPs."""
        states, inputs = torch.from_numpy(transitions.states), torch.from_numpy(transitions.inputs)
        targets = torch.from_numpy(self.increment.targets(transitions))
        return self.augmentation.regressors(states, inputs), targets

    def fit(self, transitions: Transitions, warm: bool = False) -> dict[str, float]:
        """Learn the hyperparameters from these data; returns the numbers of the fit by name.

        Args:
            transitions: all data.
            warm: begin with the present hyperparameters, instead of anew.

        Raises:
            NotPositiveDefiniteError: no jitter makes the covariance of a GP factorisable.
        """
        X, Y = self.rows(transitions)
        optimiser = self.config.optimiser
        limit = ITERATIONS[optimiser]
        self.gp.fit(X, Y, optimiser=optimiser, warm=warm, max_iterations=limit)
        with torch.no_grad():
            nlml = self.gp.nlml(X, Y)
        values = {"model/samples": float(len(X))}
        for i, noise in enumerate(self.noise_std):
            values[f"model/nlml_{i}"] = float(nlml[i])
            values[f"model/noise_std_{i}"] = noise
        return values

    @property
    def noise_std(self) -> tuple[float, ...]:
        """Learned noise of each GP, in its target's unit."""
        return tuple(self.gp.noise_std.detach().tolist())

    def dynamics(self, transitions: Transitions) -> GPDynamics | PathwisePosterior:
        """The posterior given these data, or the subset configured, as a model of the next state.

        Raises:
            NotPositiveDefiniteError: no jitter makes the covariance of a GP factorisable.
        """
        X, Y = self.rows(transitions)
        if self.config.subset_threshold is not None:
            kept = subset_of_data(self.gp, X, Y, self.config.subset_threshold)
            X, Y = X[kept], Y[kept]
        bounds = self._bounds(transitions)
        posterior = self.gp.condition(X, Y)
        dynamics = GPDynamics(posterior, self.augmentation, self.increment, bounds)
        if self.config.sampling == "step":
            return dynamics
        return PathwisePosterior(dynamics, self.config.path_features)

    def _bounds(self, transitions: Transitions) -> Float[np.ndarray, " E"]:
        """Largest plausible magnitude of each predicted state; none for one that never moved."""
        recorded = np.concatenate([transitions.states, transitions.next_states])
        largest = np.maximum(np.abs(recorded).max(0), self.task.start_std)
        bounds = np.where(largest > 0, self.config.plausible * largest, np.inf)
        return bounds[list(self.increment.predicted)]
