"""Small models and policies; only their arithmetic matters."""

from __future__ import annotations

import numpy as np
import torch

from baselines.moments import Bases, Gaussian
from baselines.pilco import PilcoConfig
from baselines.pilco.rollout import GaussianDynamics, GPMean
from mcpilco.dynamics import AngleAugmentation

TINY = PilcoConfig(centres=4, line_searches=2, evaluations=4)
"""a search that takes no time"""


def random_dynamics(
    states: int = 4,
    inputs: int = 1,
    angles: tuple[int, ...] = (2,),
    outputs: int = 4,
    samples: int = 15,
    seed: int = 0,
) -> GaussianDynamics:
    """A posterior of smooth changes."""
    rng = np.random.default_rng(seed)
    augmentation = AngleAugmentation(states, angles)
    width = augmentation.width + inputs
    X, lengthscale = rng.standard_normal((samples, width)), rng.uniform(1.5, 3.0, (outputs, width))
    distance = (X[None, :, None] - X[None, None]) / lengthscale[:, None, None]
    K = 0.1 * np.exp(-0.5 * np.square(distance).sum(-1)) + 1e-4 * np.eye(samples)
    inverse = np.linalg.inv(K)
    Y = 0.1 * np.sin(X @ rng.standard_normal((width, outputs)))
    weights = np.einsum("enm,me->en", inverse, Y)
    arrays = X, lengthscale, np.full(outputs, 0.1), weights, inverse
    A = np.eye(states) + 0.1 * rng.standard_normal((states, states))
    B = np.eye(states, outputs)
    bases = Bases(*map(torch.from_numpy, arrays))
    return GaussianDynamics(bases, augmentation, torch.from_numpy(A), torch.from_numpy(B))


def random_policy(dynamics: GaussianDynamics, inputs: int = 1, centres: int = 6) -> GPMean:
    """A policy whose bounds are not symmetric."""
    generator = torch.Generator().manual_seed(1)
    augmentation = dynamics.augmentation
    policy = GPMean(augmentation, [-1.0] * inputs, [3.0] * inputs, centres)
    size = centres, augmentation.state_dim
    states = torch.randn(size, generator=generator, dtype=torch.float64)
    policy.randomise(states, torch.ones(augmentation.width).double(), 0.5, generator)
    return policy


def narrow_start(states: int = 4) -> Gaussian:
    """Near the origin."""
    mean = 0.1 * torch.arange(states, dtype=torch.float64)
    return Gaussian(mean, 0.01 * torch.eye(states, dtype=torch.float64))
