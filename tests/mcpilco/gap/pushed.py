"""A gap that was found, for the tests of all that shows it, and a push that no model explains."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import envs
from mcpilco.gap import Gap, investigate
from mcpilco.recordings import Recording
from tests.mcpilco.gap.pendulum import dry_friction, record

HIDDEN_FRICTION = 0.1
"""Coulomb friction of the pendulum of `found` [N m]"""
PUSH_S = 4.0, 4.7
"""span of a recording in which the pendulum is pushed [s]"""


@pytest.fixture(scope="session")
def found() -> Gap:
    """A pendulum with dry friction that its plant lacks."""
    return _found()


@cache  # for all rooms of tests that have the fixture
def _found() -> Gap:
    rng = np.random.default_rng(0)
    force = dry_friction(HIDDEN_FRICTION)
    recordings = [record(rng, force, number) for number in range(3)]
    return investigate(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings)


def pushed(recording: Recording) -> Recording:
    """The recording, its angle moved for a moment."""
    states = recording.states.copy()
    inside = (recording.time >= PUSH_S[0]) & (recording.time < PUSH_S[1])
    states[inside, 0] += 0.4 * np.hanning(inside.sum())
    return replace(recording, states=states)
