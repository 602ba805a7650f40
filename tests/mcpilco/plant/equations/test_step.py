"""A step's program moves a plant as its simulation does, whatever effects it has."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from envs.plants import cart_pole, double_pendulum
from mcpilco.plant.effects import CATALOGUE
from mcpilco.plant.equations.step import numbers_of, step_of
from mcpilco.plant.plant import EffectInstance, Plant
from mcpilco.plant.simulation.motion import simulate
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

DT = 0.1
EFFECTS = {
    "none": [],
    "joint": [
        ("coulomb_friction", "cart", (0.3, 0.1)),
        ("stribeck_friction", "pole", (0.01, 0.01, 0.5, 0.1)),
        ("quadratic_drag", "cart", (0.05,)),
        ("asymmetric_friction", "cart", (0.2, 0.1, 0.1)),
        ("spring", "cart", (0.5,)),
        ("hardening_spring", "pole", (0.01,)),
        ("constant_force", "pole", (0.1,)),
        ("position_ripple", "pole", (0.05, 0.05, 3.0)),
    ],
    "body": [("body_mass", "pole", (0.1,)), ("armature", "cart", (0.1,))],
    "actuator": [
        ("actuator_gain", "actuator", (0.9,)),
        ("actuator_dead_zone", "actuator", (0.5,)),
        ("actuator_saturation", "actuator", (6.0,)),
    ],
    "sensor": [("sensor_offset", "pole_angle", (0.1,)), ("sensor_scale", "cart_position", (1.1,))],
    "delay": [("actuator_delay", "actuator", (0.1,))],
    "delay, part": [("actuator_delay", "actuator", (0.13,))],
    "lag": [("actuator_lag", "actuator", (0.05,))],
    "both": [("actuator_delay", "actuator", (0.13,)), ("actuator_lag", "actuator", (0.05,))],
}
MEMORY = {"delay": 1, "delay, part": 2, "lag": 4, "both": 6}


def task_of(plant: Plant, turned: bool = False) -> TaskSpec:
    """The task of a plant; its states in another order."""
    states, inputs = plant.layout.states, plant.layout.inputs
    states = states[::-1] if turned else states
    return TaskSpec(
        state_names=states,
        state_units=("",) * len(states),
        input_names=inputs,
        input_units=("",) * len(inputs),
        dt=DT,
        angles=(),
        velocities=(),
        start_mean=(0.0,) * len(states),
        start_std=(0.1,) * len(states),
    )


def with_effects(name: str) -> Plant:
    return cart_pole().having(
        [(EffectInstance(CATALOGUE[effect], at), values) for effect, at, values in EFFECTS[name]]
    )


def errors(plant: Plant, memory: int = 0, longest: float = 0.01, turned=False, most=5.0):
    """Differences to the simulation from random states, under random commands."""
    rng, task = np.random.default_rng(0), task_of(plant, turned)
    X, U, B = len(task.state_names), len(task.input_names), 8
    states, commands = rng.normal(size=(B, X)), rng.uniform(-most, most, (B, memory + 1, U))
    step = step_of(plant, task, longest, memory)
    own = numbers_of(plant, step.slots, np.tile(plant.nominal, (B, 1)))
    past = [commands[:, memory - 1 - k] for k in range(memory)]
    order = slice(None, None, -1 if turned else 1)
    given = np.concatenate([states[:, order], *past, commands[:, -1], own], 1)
    found = step.program(torch.from_numpy(given)).numpy()
    window = np.pad(commands, ((0, 0), (0, 1), (0, 0)))
    system, each = np.zeros(B, dtype=int), np.arange(B)
    tables = plant.tables(plant.nominal[None])
    sensors = tables.sensors[0]
    true = (states - sensors[:, 0]) / sensors[:, 1]
    seen = simulate(tables, system, true, each, window, memory, DT)[:, :, 1]
    if memory:
        np.testing.assert_array_equal(found[:, X : X + U], commands[:, -1])
        np.testing.assert_array_equal(found[:, X + U :], given[:, X : X + (memory - 1) * U])
    return np.abs(found[:, :X][:, order] - seen)


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", EFFECTS)
def test_a_step_is_that_of_the_simulation(name):
    # a lag of 0.05 s has forgotten all but e^-6 or less of commands that are not remembered
    tolerance = 5e-3 if name in ("lag", "both") else 1e-4
    longest = 0.004 if name == "joint" else 0.01  # dry friction is stiff
    assert errors(with_effects(name), MEMORY.get(name, 0), longest).max() < tolerance


def test_states_may_be_in_another_order_and_joints_be_driven_both():
    assert errors(double_pendulum(), longest=0.01, turned=True, most=0.5).max() < 1e-4


def test_the_error_falls_with_the_fourth_power_of_the_step():
    coarse, fine = (errors(cart_pole(), longest=h).max() for h in (0.05, 0.0125))
    assert coarse / fine > 4**3.5


def test_numbers_follow_the_parameters():
    plant = cart_pole()
    step = step_of(plant, task_of(plant), 0.02)
    other = plant.where(pole_length=0.7, force_gain=0.8)
    exact = step_of(other, task_of(plant), 0.02)
    given = torch.tensor([[0.1, 0.5, 2.0, -1.0, 3.0]], dtype=torch.float64)
    results = [
        made.program(torch.cat([given, torch.from_numpy(numbers_of(other, made.slots, rows))], 1))
        for made, rows in ((step, other.nominal[None]), (exact, other.nominal[None]))
    ]
    torch.testing.assert_close(*results)
    nominal = torch.from_numpy(numbers_of(plant, step.slots, plant.nominal[None]))
    assert (step.program(torch.cat([given, nominal], 1)) - results[0]).abs().max() > 0.01


@pytest.mark.parametrize(
    ("effect", "memory", "words"),
    [
        (("actuator_delay", "actuator", (0.13,)), 1, "last 2 commands"),
        (("actuator_lag", "actuator", (0.1,)), 2, "last 3 commands"),
        (("backlash", "actuator", (0.1,)), 0, "backlash"),
        (("sensor_delay", "pole_angle", (0.01,)), 0, "sensor_delay"),
    ],
)
def test_what_a_program_cannot_say_is_named(effect, memory, words):
    name, at, values = effect
    plant = cart_pole().having([(EffectInstance(CATALOGUE[name], at), values)])
    with pytest.raises(InputError, match=words):
        step_of(plant, task_of(plant), 0.02, memory)


def test_another_plants_task_is_named():
    task = dataclasses.replace(task_of(cart_pole()), input_names=("push",))
    with pytest.raises(InputError, match="inputs push"):
        step_of(cart_pole(), task, 0.02)
