"""The step that is timed: particles, cost, backward and Adam, in a model of random data."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from mcpilco.config import Phase, SearchConfig
from mcpilco.dynamics import AngleAugmentation, GPDynamics, speed_integration
from mcpilco.gp import GP
from mcpilco.kernels import MPK, RBF
from mcpilco.policies import SumOfGaussians, cart_pole_cost
from mcpilco.search import Adam, PolicySearch, Problem, RolloutFunction, fused, rollout
from mcpilco.task import TaskSpec

ENGINES = {
    "fused": fused.rollout,
    "float32": functools.partial(fused.rollout, single=True),
    "eager": rollout,
}
TASK = TaskSpec(
    state_names=("cart_position", "cart_velocity", "pole_angle", "pole_velocity"),
    state_units=("m", "m/s", "rad", "rad/s"),
    input_names=("force",),
    input_units=("N",),
    dt=0.05,
    angles=(2,),
    velocities=((0, 1), (2, 3)),
    start_mean=(0.0,) * 4,
    start_std=(0.01,) * 4,
    cost=cart_pole_cost(1.0, 3.0),
)
DROPOUT = 0.25
LEARNING_RATE = 0.01


@dataclass(frozen=True)
class Size:
    """How large a step is."""

    particles: int
    samples: int
    """N, training samples of each GP"""
    steps: int
    """T, horizon"""
    bases: int


def make_step(size: Size, engine: str) -> Callable[[], object]:
    """Our step, of random data."""
    generator = torch.Generator().manual_seed(0)
    problem, policy = make_problem(size, TASK, generator, ENGINES[engine])
    phases = (Phase(LEARNING_RATE, DROPOUT),)
    config = SearchConfig(particles=size.particles, phases=phases, clip_norm=None)
    search = PolicySearch(config, generator)
    adam = Adam(policy)
    return lambda: search.step(problem, policy, adam, LEARNING_RATE, DROPOUT)


def make_problem(
    size: Size, task: TaskSpec, generator: torch.Generator, rollout: RolloutFunction
) -> tuple[Problem, SumOfGaussians]:
    """A cart-pole's search in a model of random data, and where it begins."""
    X = torch.randn(size.samples, 6, generator=generator, dtype=torch.float64)
    Y = 0.003 * torch.randn(size.samples, 2, generator=generator, dtype=torch.float64)
    kernel = RBF(6, (2,)) + MPK(6, 2, (2,))
    kernel.start_from(X, Y)
    augmentation = AngleAugmentation(4, task.angles)
    posterior = GP(kernel, noise_floor=0.001).condition(X, Y)
    dynamics = GPDynamics(posterior, augmentation, speed_integration(task), np.full(2, 1e3))
    policy = SumOfGaussians(augmentation, [-10.0], [10.0], size.bases)
    span = torch.full((3,), torch.pi, dtype=torch.float64)
    policy.randomise(span, torch.ones_like(span), 1.0, 5.0, generator)
    start, std = (torch.tensor(t, dtype=torch.float64) for t in (task.start_mean, task.start_std))
    return Problem(dynamics, task.cost, start, std, size.steps, 1.0, rollout), policy


def cpu_seconds(step: Callable[[], object]) -> float:
    before = time.process_time()
    step()
    return time.process_time() - before
