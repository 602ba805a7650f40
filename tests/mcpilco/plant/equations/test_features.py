"""Features hold what physics says of the accelerations, and of friction at rest."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from envs.plants import cart_pole
from mcpilco.plant.equations.features import friction_features, physics_features
from mcpilco.plant.equations.program import features_of
from mcpilco.plant.equations.step import free_parameters, numbers_of, step_of
from tests.mcpilco.plant.equations.test_step import DT, task_of

GIVEN = torch.tensor([[0.1, 0.5, 2.0, -1.0, 3.0], [0.0, -0.2, 1.0, 2.0, -4.0]]).double()


def test_physics_features_tell_the_accelerations_of_other_parameters():
    plant, short = cart_pole(), 1e-4
    task = dataclasses.replace(task_of(plant), dt=short)
    program, (count,) = features_of(5, [physics_features(plant, task)])
    rows = program(GIVEN).unflatten(-1, (-1, 2))
    free = free_parameters(plant)
    assert count == 2 * (1 + len(free))
    logs = np.linspace(-0.02, 0.02, len(free))
    parameters = plant.nominal
    parameters[list(free)] *= np.exp(logs)
    step = step_of(plant, task, short)
    own = torch.from_numpy(numbers_of(plant, step.slots, np.tile(parameters, (2, 1))))
    exact = (step.program(torch.cat([GIVEN, own], 1)) - GIVEN[:, :4])[:, [1, 3]] / short
    linear = (rows[:, 0] + (torch.from_numpy(logs)[:, None] * rows[:, 1:]).sum(1)) / short
    nominal = rows[:, 0] / short
    assert ((linear - exact).abs() < 0.1 * (nominal - exact).abs()).all()


def test_friction_features_turn_over_at_the_gate_and_hold_at_rest():
    task = dataclasses.replace(task_of(cart_pole()), velocities=((0, 1), (2, 3)), dt=DT)
    program, (count,) = features_of(5, [friction_features(task, gate=0.05)])
    assert count == 6
    rest = torch.tensor([[0.3, 0.0, 1.0, 2.0, 4.0]], dtype=torch.float64, requires_grad=True)
    features = program(rest)
    torch.testing.assert_close(
        features.detach(), torch.tensor([[0.0, 0.0, 4.0, 2.0, 1.0, 0.0]], dtype=torch.float64)
    )
    (slope,) = torch.autograd.grad(features.sum(), rest)
    assert slope.isfinite().all()
    assert float(slope[0, 1]) == 1.0 + 1.0 / 0.05
