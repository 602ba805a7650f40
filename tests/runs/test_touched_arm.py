"""The arm of `runs/touched_arm`: its plant with the hidden effect moves as MuJoCo's arm does."""

from __future__ import annotations

import numpy as np
import pytest

import envs
from mcpilco.plant import CATALOGUE, EffectInstance

SEEDS = {"body_mass": 11, "viscous_friction": 1, "coulomb_friction": 4, "actuator_gain": 0}


def recorded(run, monkeypatch, seed: int, *pushes: tuple[float, float, float]):
    """The plant, what is hidden, and a recording without noise."""
    monkeypatch.setattr(run, "NOISE", dict.fromkeys(run.NOISE, 0.0))
    monkeypatch.setattr(run, "SECONDS", 1.5)
    rng, plant = np.random.default_rng(seed), envs.PLANTS[run.PLANT]()
    arm, hidden = run.drawn(plant, rng)
    log, _ = run.recorded(arm, rng, pushes=pushes)
    return plant, hidden, run.of_plant(plant, log, 0)


def foretold(run, plant, recording) -> np.ndarray:
    start, commands = recording.states[:1], recording.inputs[None, :-1]
    return plant.simulate(start, commands, run.DT)[0]


@pytest.mark.parametrize("name", SEEDS)
def test_the_plant_with_the_hidden_effect_moves_as_the_arm(run, monkeypatch, name: str) -> None:
    plant, hidden, recording = recorded(run, monkeypatch, SEEDS[name])
    assert hidden.name == name
    effect = CATALOGUE[name]
    values = [hidden.value if s.name == hidden.symbol else 2e-3 for s in effect.symbols]
    corrected = plant.having([(EffectInstance(effect, hidden.target), tuple(values))])
    far = np.abs(foretold(run, plant, recording) - recording.states).max()
    near = np.abs(foretold(run, corrected, recording) - recording.states).max()
    assert near < 0.02 * far


def test_a_push_moves_the_arm_while_it_lasts(run, monkeypatch) -> None:
    _, _, free = recorded(run, monkeypatch, 0)
    _, _, pushed = recorded(run, monkeypatch, 0, (0.8, 0.3, 1.5))
    apart = np.abs(pushed.states - free.states).max(axis=1)
    assert apart[free.time <= 0.8].max() == 0.0
    assert apart[free.time > 0.9].max() > 0.05
