"""A gap that was found, for the tests of all that shows it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import envs
from mcpilco.gap import Gap, investigate
from tests.mcpilco.gap.pendulum import record

HIDDEN_FRICTION = 0.1
"""Coulomb friction of the pendulum of `found` [N m]"""
PUSH_S = 4.0, 4.7
"""span of its second recording in which it is pushed [s]"""


@pytest.fixture(scope="session")
def found() -> Gap:
    """A pendulum with dry friction that nobody told of, and a push."""
    rng = np.random.default_rng(3)

    def force(q: float, v: float) -> float:
        return -HIDDEN_FRICTION * v / float(np.hypot(v, 2e-3))

    recordings = [record(rng, force, number) for number in range(3)]
    states = recordings[1].states.copy()
    inside = (recordings[1].time >= PUSH_S[0]) & (recordings[1].time < PUSH_S[1])
    states[inside, 0] += 0.4 * np.hanning(inside.sum())
    recordings[1] = replace(recordings[1], states=states)
    return investigate(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings)
