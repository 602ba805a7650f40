"""Motions of plants against the closed forms of `tests.reference`."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

import envs
from tests.reference import REFERENCES

IDS = [name for name in REFERENCES if name in envs.PLANTS]
each_plant = pytest.mark.parametrize("name", IDS)


def drawn(name: str, *batch: int) -> tuple[np.ndarray, np.ndarray]:
    """States in any turn, fast and slow, and inputs."""
    rng, swing_up = np.random.default_rng(0), gym.make(name).unwrapped.swing_up
    spread = np.tile([3.0, 8.0], swing_up.width // 2)
    inputs = swing_up.input_limit * rng.uniform(-1, 1, (*batch, 1))
    return spread * rng.standard_normal((*batch, swing_up.width)), inputs


@each_plant
@pytest.mark.parametrize("batch", [(300,), (), (2, 3)], ids=str)
def test_step_is_the_motion_of_the_closed_form(name, batch):
    swing_up = gym.make(name).unwrapped.swing_up
    states, inputs = drawn(name, *batch)
    motion = swing_up.motion(*batch)
    motion.restart(True, states)
    path = motion.advance(inputs)
    expected = REFERENCES[name].advance(states, inputs[..., 0], swing_up.dt, swing_up.samples)
    np.testing.assert_allclose(path, expected, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(motion.states, path[-1])
    np.testing.assert_array_equal(motion.measured, path[-1])


@each_plant
def test_batch_is_a_loop_of_single_motions(name):
    swing_up = gym.make(name).unwrapped.swing_up
    states, inputs = drawn(name, 5)
    together, alone = swing_up.motion(5), swing_up.motion()
    together.restart(True, states)
    path = together.advance(inputs)
    for b in range(5):
        alone.restart(True, states[b])
        np.testing.assert_array_equal(alone.advance(inputs[b]), path[:, b])
