"""Regressors of Gaussian processes that physics and friction suggest, as programs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from mcpilco.plant.arithmetic import Real, exp
from mcpilco.plant.effects.joint import CoulombFriction, ViscousFriction
from mcpilco.plant.equations import step
from mcpilco.plant.equations.program import Rows
from mcpilco.plant.plant import Plant
from mcpilco.task import TaskSpec


def physics_features(plant: Plant, task: TaskSpec, memory: int = 0) -> Rows:
    """The change of velocities by the equations of motion, and its derivatives by the parameters.

    For each joint dt q'' by the nominal parameters, and its derivative by the logarithm of each
    uncertain one: a linear combination of these is the change of velocity, up to what a step of dt
    is too long for, and to second order in the parameters' errors.

    Raises:
        InputError: names differ, or the plant has what a program cannot say.
    """
    step.require_expressible(plant, task, plant.tables(plant.nominal[None]), memory)
    X, U = len(task.state_names), len(task.input_names)
    order = step.order_of(plant, task)

    def rows(given: Sequence[Real]) -> list[Any]:
        commands = step.commands_of(given[X:], U, memory)

        def changes(values: Float[np.ndarray, " P"]) -> list[Any]:
            system = step.system_of(plant.tables(values[None]), {})
            q, v = step.true_state(system, order, given[:X])
            forces = [
                step.segments(system, u, [now[i] for now in commands], task.dt)[-1]
                for u, i in enumerate(order[1])
            ]
            ends = [force.force_at(task.dt) for force in forces]
            return [task.dt * a for a in step.accelerations(system, q, v, ends)]

        found = changes(plant.nominal)
        for i in step.free_parameters(plant):
            low, high = plant.nominal, plant.nominal
            low[i] *= math.exp(-step.PERTURBATION)
            high[i] *= math.exp(step.PERTURBATION)
            pairs = zip(changes(high), changes(low), strict=True)
            found += [(up - down) / (2 * step.PERTURBATION) for up, down in pairs]
        return found

    return rows


def friction_features(task: TaskSpec, gate: float) -> Rows:
    """For each velocity v: v, tanh(v / gate), and exp(-(v / gate)^2) u for each input u.

    Viscous and dry friction, and what holds a joint at rest against a force: there the gate is
    open. It is smooth, so that a policy's gradient passes through it.

    Dry friction turns over within the velocity `gate` [m/s or rad/s].

    Reference: thesis chapter 4 (the friction-compensating kernel).
    Differs: its indicator of rest is a bell here.
    """
    U = len(task.input_names)

    def rows(given: Sequence[Real]) -> list[Any]:
        found: list[Any] = []
        for _, velocity in task.velocities:
            v = given[velocity]
            viscous, dry = ViscousFriction.force, CoulombFriction.force
            rest = exp(-1.0 * (v / gate) * (v / gate))
            found += [viscous(0.0, v, -1.0), dry(0.0, v, -1.0, gate)]
            found += [rest * u for u in given[len(given) - U :]]
        return found

    return rows
