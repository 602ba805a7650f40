"""A pendulum so light that its motor can turn it over, with an effect of the catalogue."""

from __future__ import annotations

import numpy as np

import envs
from mcpilco.plant import CATALOGUE, EffectInstance
from mcpilco.recordings import Recording
from tests.mcpilco.gap.pendulum import DT, STD

LIGHT = envs.PLANTS["mcpilco/Pendulum-v0"]().where(mass=0.06)


def spun(effect: str, values: tuple[float, ...], pieces: int) -> Recording:
    """Angles under torques that are held for half a second each."""
    rng, layout = np.random.default_rng(2), LIGHT.layout
    torque = np.repeat(rng.uniform(-1.0, 1.0, pieces), 25)[:, None]
    plant = LIGHT.having([(EffectInstance(CATALOGUE[effect], "pendulum"), values)])
    states = plant.simulate(np.zeros((1, 2)), torque[None, :-1], DT)[0]
    states += rng.standard_normal(states.shape) * [STD, np.nan]
    time = DT * np.arange(len(torque))
    return Recording(effect, time, states, torque, layout.states, layout.inputs)
