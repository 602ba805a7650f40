"""Dry friction turns over no faster than the steps of an integration can follow."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch

from envs.plants import cart_pole, double_pendulum
from mcpilco.plant.effects import CATALOGUE
from mcpilco.plant.equations.step import followable, most_mobile, numbers_of, step_of, system_of
from mcpilco.plant.plant import EffectInstance, Plant
from tests.mcpilco.plant.equations.test_step import task_of

SHARP = {
    "coulomb_friction": (2.0, 0.002),
    "stribeck_friction": (1.0, 1.0, 0.1, 0.002),
    "asymmetric_friction": (2.0, 1.0, 0.002),
}


def rubbing(name: str, joint: str = "cart", plant: Plant | None = None) -> Plant:
    active = EffectInstance(CATALOGUE[name], joint)
    return (plant or cart_pole()).having([(active, SHARP[name])])


def slope_at_rest(plant: Plant, longest: float) -> np.ndarray:
    """Derivative of the cart's next velocity by the one before, at rest in many poses."""
    step = step_of(plant, task_of(plant), longest)
    states = torch.zeros(20, 5, dtype=torch.float64)
    states[:, 2] = torch.linspace(-3.0, 3.0, 20)
    states.requires_grad_(True)
    own = torch.from_numpy(numbers_of(plant, step.slots, np.tile(plant.nominal, (20, 1))))
    following = step.program(torch.cat([states, own], 1))
    return torch.autograd.grad(following[:, 1].sum(), states)[0][:, 1].numpy()


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", SHARP)
@pytest.mark.parametrize("longest", [0.1, 0.05, 0.025, 0.01])
def test_rest_is_not_left_by_leaps(name, longest):
    assert np.abs(slope_at_rest(rubbing(name), longest)).max() < 1.05


def test_steps_that_can_follow_leave_friction_as_it_is():
    plant = rubbing("stribeck_friction")
    known = system_of(plant.tables(plant.nominal[None]), {})
    system = copy.deepcopy(known)
    followable(known, system, step=1e-4)
    constants = [law[2] for law in known.laws]
    assert [law[2] for law in system.laws] == constants
    followable(known, system, step=1e-2)
    assert [law[2] for law in system.laws] != constants


def test_friction_elsewhere_is_not_slowed_down():
    plant = rubbing("coulomb_friction", "elbow", double_pendulum())
    plant = plant.having(
        [(EffectInstance(CATALOGUE["coulomb_friction"], "shoulder"), (1e-6, 0.002))]
    )
    known = system_of(plant.tables(plant.nominal[None]), {})
    system = copy.deepcopy(known)
    followable(known, system, step=0.01)
    turns = {joint: constants[1] for _, joint, constants in system.laws if len(constants) == 2}
    assert turns[0] == 0.002 < turns[1]


def test_a_cart_is_most_mobile_where_its_pole_gives_way():
    """With the pole level, only the cart is pushed: 1/m."""
    plant = cart_pole().where(cart_mass=0.5, pole_mass=0.5)
    known = system_of(plant.tables(plant.nominal[None]), {})
    assert 1.0 / 1.0 < most_mobile(known)[0] <= 1.0 / (0.5 + 0.5 / 4) + 1e-9
