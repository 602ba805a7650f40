"""What each model predicts of a rollout: the moments of the states, and particles where it has any.

A model is fitted to one random rollout, and starts from the first measurement of another one with
the measurement's own error. It knows the inputs: those that were applied, or the policy that
chooses them from its predicted states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Float

from baselines.moments.image import Gaussian
from baselines.pilco.model import PilcoConfig, PilcoModel
from baselines.pilco.rollout import GaussianDynamics, GPMean, predicted
from mcpilco.agent import Model, input_bounds, load_policy
from mcpilco.config import ModelConfig
from mcpilco.data import Rollout, Transitions
from mcpilco.dynamics import AngleAugmentation
from mcpilco.files import read_arrays
from mcpilco.search import rollout
from mcpilco.task import TaskSpec

PARTICLES = 400
MODELS = ("pilco", "rbf", "mpk", "rbf+mpk")
"""pilco: one Gaussian, matched in its moments; the others: particles, by their kernels"""


@dataclass(frozen=True)
class Forecast:
    """Predicted states at times 0 to T."""

    mean: Float[np.ndarray, "T_plus_1 X"]
    cov: Float[np.ndarray, "T_plus_1 X X"]
    particles: Float[np.ndarray, "T_plus_1 P X"] | None = None
    """None: the distribution is the Gaussian"""

    def interval(self) -> Float[np.ndarray, "2 T_plus_1 X"]:
        """Ends of the central 95 % of each state."""
        if self.particles is not None:
            return np.quantile(self.particles, (0.025, 0.975), axis=1)
        half = 1.959963984540054 * np.sqrt(np.diagonal(self.cov, axis1=1, axis2=2))
        return np.stack([self.mean - half, self.mean + half])


Forecaster = Callable[[Rollout, GPMean | None, np.random.Generator], Forecast]
"""from a rollout, of which it sees the first measurement and the inputs, a policy in place of the
inputs, and random numbers, to what is predicted of it"""


def forecaster(
    model: str, data: Transitions, task: TaskSpec, noise_std: Float[np.ndarray, " X"]
) -> Forecaster:
    """A model fitted to these data.

    Args:
        model: one of `MODELS`.
        data: of one random rollout.
        task: names, angles and velocities of the state.
        noise_std: of a measurement, in the states' units.
    """
    return (_gaussian if model == "pilco" else _sampled)(model, data, task, noise_std)


def _gaussian(
    model: str, data: Transitions, task: TaskSpec, noise_std: Float[np.ndarray, " X"]
) -> Forecaster:
    gp = PilcoModel(PilcoConfig(), task)
    gp.fit(data)
    dynamics = gp.moments(data)
    error = torch.diag(torch.from_numpy(noise_std).square())

    @torch.no_grad()
    def forecast(seen: Rollout, policy: GPMean | None, rng: np.random.Generator) -> Forecast:
        start = Gaussian(torch.from_numpy(seen.observations[0]), error)
        if policy is None:
            steps = [start]
            for inputs in torch.from_numpy(seen.inputs):
                steps.append(pushed(dynamics, steps[-1], inputs))
            mean, cov = (torch.stack([vars(s)[name] for s in steps]) for name in ("mean", "cov"))
            states = Gaussian(mean, cov)
        else:
            states, _ = predicted(dynamics, policy, start, len(seen))
        return Forecast(states.mean.numpy(), states.cov.numpy())

    return forecast


def pushed(
    dynamics: GaussianDynamics, state: Gaussian, inputs: Float[torch.Tensor, " U"]
) -> Gaussian:
    """The next state under inputs that are known, in the env's unit.

    They are the middle of the bounds of a policy that has learned nothing.
    """
    low, high = (inputs - 1.0).numpy(), (inputs + 1.0).numpy()
    policy = GPMean(dynamics.augmentation, low, high, centres=1)
    states, _ = predicted(dynamics, policy, state, 1)
    return Gaussian(states.mean[1], states.cov[1])


def _sampled(
    model: str, data: Transitions, task: TaskSpec, noise_std: Float[np.ndarray, " X"]
) -> Forecaster:
    gp = Model(ModelConfig(kernel=model), task)
    gp.fit(data)
    dynamics = gp.dynamics(data)

    @torch.no_grad()
    def forecast(seen: Rollout, policy: GPMean | None, rng: np.random.Generator) -> Forecast:
        start = seen.observations[0] + noise_std * rng.standard_normal((PARTICLES, len(noise_std)))
        noise = rng.standard_normal((len(seen), PARTICLES, dynamics.noise_dim))
        acts = _Replay(torch.from_numpy(seen.inputs)) if policy is None else policy
        found = rollout(dynamics, acts, torch.from_numpy(start), torch.from_numpy(noise))
        particles = found.states.numpy()
        mean = particles.mean(1)
        off = particles - mean[:, None]
        cov = np.einsum("tpi,tpj->tij", off, off) / (PARTICLES - 1)
        return Forecast(mean, cov, particles)

    return forecast


class _Replay:
    """Answers inputs that are known, whatever the state."""

    def __init__(self, inputs: torch.Tensor) -> None:
        self._inputs = inputs

    def __call__(self, states: torch.Tensor, dropout: object = None, step: int = 0) -> torch.Tensor:
        return self._inputs[step].expand(len(states), -1)


def read_policy(path: Path, env: gym.Env, task: TaskSpec) -> GPMean:
    """The policy of a run of PILCO in this env, from the run's `policy.npz`."""
    arrays = read_arrays(path)
    augmentation = AngleAugmentation(len(task.state_names), task.angles)
    policy = GPMean(augmentation, *input_bounds(env), len(arrays["centres"]))
    load_policy(policy, arrays)
    return policy
