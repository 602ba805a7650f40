"""A pendulum with a lag and friction, and recordings of any plant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

import envs
from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.fit import Fit, fit_initial_states, fit_model
from mcpilco.gap.plant_model import PlantModel
from mcpilco.plant import CATALOGUE, EffectInstance, Plant
from mcpilco.recordings import Recording

STD = {"m": 1e-3, "rad": 2e-3}


def active(name: str, target: str) -> EffectInstance:
    return EffectInstance(CATALOGUE[name], target)


def recorded(machine: Plant, count: int, seconds: float = 8.0) -> list[Recording]:
    """Recordings of a plant under steps that a seed draws; positions only, with noise."""
    layout, rng, dt = machine.layout, np.random.default_rng(0), 0.02
    found = []
    for number in range(count):
        steps = rng.uniform(-1.2, 1.2, (round(seconds / 0.4), len(layout.inputs)))
        commands = np.repeat(steps, 20, axis=0)
        start = rng.normal(0.0, 0.2, (1, len(layout.states)))
        states = machine.simulate(start, commands[None, :-1], dt)[0]
        for x, unit in enumerate(layout.units):
            noise = STD.get(unit, np.nan)
            states[:, x] += noise * rng.standard_normal(len(states))
        time = dt * np.arange(len(commands))
        names = layout.states, layout.inputs
        found.append(Recording(f"recording_{number}", time, states, commands, *names))
    return found


def problem(plant: Plant, hidden: Sequence[tuple[EffectInstance, Sequence[float]]]) -> GapProblem:
    return GapProblem.of(plant, recorded(plant.having(hidden), 2), 0.01, (), {})


def fitted(model: PlantModel, windows: Windows, theta: np.ndarray) -> Fit:
    return fit_model(model, windows, theta, fit_initial_states(model, windows, theta))


@pytest.fixture(scope="module")
def lagging() -> tuple[GapProblem, Windows, Fit]:
    """A pendulum with a lag and friction, and the nominal fit."""
    hidden = [
        (active("actuator_lag", "actuator"), (0.08,)),
        (active("coulomb_friction", "pendulum"), (0.1, 2e-3)),
    ]
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), hidden)
    windows = known.windows()
    model = known.model(windows)
    return known, windows, fitted(model, windows, np.zeros(model.nuisances))
