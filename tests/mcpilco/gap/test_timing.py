"""When commands went out, as a model tells it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import envs
from mcpilco.gap.fit import Fit
from mcpilco.gap.given import Given
from mcpilco.gap.timing import likelier, timings
from mcpilco.plant import CATALOGUE, EffectInstance, Plant
from mcpilco.recordings import Recording

DT = 0.02


def recorded(machine: Plant, by_clock: bool) -> Recording:
    """Ten seconds of a pendulum under steps; the stamps of the samples stray by 3 ms."""
    rng = np.random.default_rng(0)
    torque = np.repeat(rng.uniform(-1.2, 1.2, 50), 10)
    late = rng.uniform(0.0, 0.15, len(torque))  # part of a step by which the command is late
    mixed = torque - late * np.diff(torque, prepend=torque[0])
    sent = torque if by_clock else mixed
    states = machine.simulate(np.array([[0.3, 0.0]]), sent[None, :-1, None], DT)[0]
    states += rng.standard_normal(states.shape) * [2e-3, np.nan]
    time, layout = DT * np.arange(len(torque)), machine.layout
    found = Recording("a", time, states, mixed[:, None], layout.states, layout.inputs)
    return replace(found, by_clock=torque[:, None])


def given(machine: Plant, by_clock: bool) -> list[Given]:
    told = timings([recorded(machine, by_clock)])
    return [Given.of(envs.PLANTS["mcpilco/Pendulum-v0"](), r, 0.01, (), {}) for r in told]


@pytest.mark.parametrize("by_clock", [True, False])
def test_the_motion_tells_when_commands_went_out(by_clock: bool) -> None:
    sent = given(envs.PLANTS["mcpilco/Pendulum-v0"](), by_clock)
    assert likelier(sent) is sent[by_clock]


def test_a_model_that_fits_tells_what_a_missing_effect_hides() -> None:
    friction = EffectInstance(CATALOGUE["coulomb_friction"], "pendulum")
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    sent = given(plant.having([(friction, (0.15, 2e-3))]), by_clock=False)
    nominal = sent[0].model(sent[0].windows())
    model, theta = nominal.grown(np.zeros(nominal.nuisances), friction, (0.15, 2e-3))
    known = Fit(model, theta, np.zeros((0, 2)), 0.0, np.zeros(0))
    assert likelier(sent, known) is sent[0]


def test_without_doubt_there_is_one_timing() -> None:
    recording = replace(recorded(envs.PLANTS["mcpilco/Pendulum-v0"](), True), by_clock=None)
    assert timings([recording]) == [(recording,)]
