"""A model of the next state as linear systems: about a point, its draws too; along a motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.dynamics.dynamics import GPDynamics
from mcpilco.dynamics.pathwise import PathwisePosterior
from mcpilco.dynamics.physics import PhysicsDynamics

NUDGE = 1e-3
"""of central differences, in the unit of each state and input"""


@dataclass(frozen=True)
class Linearised:
    """x' = after + A (x - x0) + B (u - u0) of S linear systems, the first that of the mean."""

    after: Float[np.ndarray, "S X"]
    """the state that follows x0 and u0, in each state's unit"""
    A: Float[np.ndarray, "S X X"]
    """by the state"""
    B: Float[np.ndarray, "S X U"]
    """by the inputs"""


@torch.no_grad()
def linearised(
    dynamics: GPDynamics | PathwisePosterior | PhysicsDynamics,
    state: Float[Tensor, " X"],
    inputs: Float[Tensor, " U"],
    draws: int = 0,
    seed: int = 0,
) -> Linearised:
    """The slopes of a model's mean at a state and input, and those of functions drawn from it.

    A draw is of all that the model leaves open: the plant's parameters, and the Gaussian process,
    whose values and slopes at the point are jointly normal.

    Args:
        dynamics: the model, given its data.
        state: x0, past inputs included, each in its unit.
        inputs: u0, each in its unit.
        draws: how many functions, S - 1.
        seed: of the draws.

    Reference: Rasmussen & Williams 2006, section 9.4 (derivatives of a Gaussian process).
    """
    model = _of_changes(dynamics)
    X, D, S = len(state), len(state) + len(inputs), 1 + draws
    generator = torch.Generator().manual_seed(seed)
    eye = torch.eye(D, dtype=torch.float64)
    at = torch.cat([state, inputs]) + NUDGE * torch.cat([torch.zeros(1, D), eye, -eye])
    # the value, then central differences
    contrast = torch.zeros(1 + D, len(at), dtype=torch.float64)
    contrast[0, 0] = 1.0
    contrast[1:, 1:] = torch.cat([eye, -eye], 1) / (2 * NUDGE)

    posterior, asked = model.posterior, model.regressors(at[:, :X], at[:, X:])
    k = posterior.kernel(posterior.X, asked)  # E N M
    V = posterior.L_inv @ k
    covariance = contrast @ (posterior.kernel(asked, asked) - V.mT @ V) @ contrast.T
    sizes, axes = torch.linalg.eigh((covariance + covariance.mT) / 2)
    noise = torch.randn(len(k), S, 1 + D, generator=generator, dtype=torch.float64)
    noise[:, 0] = 0.0
    weights = posterior.alpha[:, None].expand(-1, S, -1)  # E S N
    if isinstance(dynamics, PhysicsDynamics):
        physics, drawn = dynamics.physics, dynamics.draw(draws, generator)
        own = torch.cat([physics.numbers(physics.belief.mean[None]), drawn.numbers])
        weights = torch.cat([weights[:, :1], weights[:, 1:] + drawn.weights.mT], 1)
        given = torch.cat([at.expand(S, -1, -1), own[:, None].expand(-1, len(at), -1)], -1)
        drift = dynamics.program(given)  # S M X
    else:
        drift = (at[:, :X] @ model.A.T + at[:, X:] @ model.C.T).expand(S, -1, -1)
    root = axes * sizes.clamp_min(0.0).sqrt()[:, None]
    changes = (weights @ k) @ contrast.T + noise @ root.mT  # E S 1+D
    rows = (contrast @ drift + changes.permute(1, 2, 0) @ model.B.T).numpy()  # S 1+D X
    slopes = rows[:, 1:].swapaxes(1, 2)
    return Linearised(rows[:, 0], slopes[..., :X], slopes[..., X:])


class Course(NamedTuple):
    """x' = after + A (x - x0) + w about each of T points of a motion."""

    after: Float[np.ndarray, "T X"]
    """the states that are expected to follow, in each state's unit"""
    A: Float[np.ndarray, "T X X"]
    """by the state"""
    W: Float[np.ndarray, "T X X"]
    """covariance of w: what the model does not know of a change, and the noise that was learned"""


@torch.no_grad()
def linearised_along(
    dynamics: GPDynamics | PathwisePosterior | PhysicsDynamics,
    states: Float[np.ndarray, "T X"],
    inputs: Float[np.ndarray, "T U"],
) -> Course:
    """The mean of a model and its slopes about the states of a motion under these inputs."""
    model, (T, X) = _of_changes(dynamics), states.shape
    eye = NUDGE * np.eye(X)
    nudges = np.concatenate([np.zeros((1, X)), eye, -eye])
    at = torch.from_numpy((nudges[:, None] + states).reshape(-1, X))
    u = torch.from_numpy(inputs).repeat(len(nudges), 1)
    mean, variance = model.posterior.mean_and_variance(model.regressors(at, u))
    if isinstance(dynamics, PhysicsDynamics):
        own = dynamics.physics.numbers(dynamics.physics.belief.mean[None]).expand(len(at), -1)
        after = model.moved(at, dynamics.program(torch.cat([at, u, own], -1)), mean)
    else:
        after = model.advance(at, u, mean)
    following = after.numpy().reshape(-1, T, X)
    A = (following[1 : 1 + X] - following[1 + X :]).transpose(1, 2, 0) / (2 * NUDGE)
    B, spread = model.B.numpy(), variance[:T] + model.posterior.noise_std.square()
    return Course(following[0], A, np.einsum("xe,ne,ye->nxy", B, spread.numpy(), B))


def _of_changes(dynamics: GPDynamics | PathwisePosterior | PhysicsDynamics) -> GPDynamics:
    """The Gaussian processes in a model."""
    if isinstance(dynamics, PhysicsDynamics):
        return dynamics.model
    return dynamics.dynamics if isinstance(dynamics, PathwisePosterior) else dynamics
