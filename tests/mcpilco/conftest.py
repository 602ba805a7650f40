"""Small models and policies for the tests of whatever rolls particles out."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mcpilco.dynamics import AngleAugmentation, GPDynamics, speed_integration
from mcpilco.gp import GP
from mcpilco.kernels import MPK, RBF, Kernel
from mcpilco.policies import SumOfGaussians, cart_pole_cost
from mcpilco.task import TaskSpec
from tests.mcpilco.gap.pushed import found  # noqa: F401  a fixture


@pytest.fixture
def task() -> TaskSpec:
    return TaskSpec(
        state_names=("cart_position", "cart_velocity", "pole_angle", "pole_velocity"),
        state_units=("m", "m/s", "rad", "rad/s"),
        input_names=("force",),
        input_units=("N",),
        dt=0.1,
        angles=(2,),
        velocities=((0, 1), (2, 3)),
        start_mean=(0.0,) * 4,
        start_std=(0.1,) * 4,
        cost=cart_pole_cost(),
    )


def make_dynamics(
    task: TaskSpec,
    kernel: Kernel | None = None,
    samples: int = 25,
    bounds: float = 50.0,
    seed: int = 0,
    increment=speed_integration,
    noise_floor: float = 0.05,
) -> GPDynamics:
    """A GP model of random smooth changes, not fitted: only its arithmetic matters."""
    generator = torch.Generator().manual_seed(seed)
    augmentation = AngleAugmentation(len(task.state_names), task.angles)
    width = augmentation.width + len(task.input_names)
    law = increment(task)
    outputs = len(law.predicted)
    if kernel is None:
        kernel = RBF(width, (outputs,)) + MPK(width, 2, (outputs,))
    X = torch.randn(samples, width, generator=generator, dtype=torch.float64)
    Y = torch.sin(X @ torch.randn(width, outputs, generator=generator, dtype=torch.float64))
    gp = GP(kernel, noise_std=2 * noise_floor, noise_floor=noise_floor)
    kernel.start_from(X, Y)
    return GPDynamics(gp.condition(X, Y), augmentation, law, np.full(outputs, bounds))


def make_policy(task: TaskSpec, bases: int = 30, inputs: int = 1, seed: int = 0) -> SumOfGaussians:
    """A random policy with bounds +-10."""
    generator = torch.Generator().manual_seed(seed)
    augmentation = AngleAugmentation(len(task.state_names), task.angles)
    policy = SumOfGaussians(augmentation, [-10.0] * inputs, [10.0] * inputs, bases)
    plain = torch.ones(len(augmentation.plain), dtype=torch.float64)
    policy.randomise(2 * plain, plain, 1.0, 5.0, generator)
    return policy
