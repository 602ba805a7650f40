"""Laws of the test of the Markov property: memory gains only where something is hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcpilco.agent.predictability import reward_share, state_gains
from mcpilco.data import Rollout
from tests.mcpilco.point import TASK

POSITION_ONLY = replace(
    TASK,
    state_names=("position",),
    state_units=("m",),
    velocities=(),
    start_mean=(0.0,),
    start_std=(0.1,),
)
A, B = np.array([[1.0, 0.2], [-0.4, 0.9]]), np.array([0.02, 0.2])


def episodes(noise: float = 0.0, delay: int = 0, steps: int = 100, count: int = 3) -> list[Rollout]:
    """A spring under random inputs, which act `delay` steps late; noise in parts of the spread."""
    rng, found = np.random.default_rng(0), []
    for _ in range(count):
        inputs = rng.uniform(-2, 2, (steps, 1))
        states = [rng.normal(0, 0.3, 2)]
        for step in range(steps):
            acting = inputs[step - delay, 0] if step >= delay else 0.0
            states.append(A @ states[-1] + B * acting)
        seen = np.array(states) * (1 + noise * rng.standard_normal((steps + 1, 2)))
        rewards = -(np.array(states)[1:, 0] ** 2)
        found.append(Rollout(0.2, seen, inputs, rewards))
    return found


def positions(record: Rollout) -> Rollout:
    return replace(record, observations=record.observations[:, :1])


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def test_memory_gains_nothing_where_the_state_is_whole() -> None:
    for gain in state_gains(TASK, episodes(), rng()):
        assert gain.high < 1.5
        assert gain.unexplained < 0.05


def test_memory_gains_little_from_noise_alone() -> None:
    assert all(gain.low < 1.5 for gain in state_gains(TASK, episodes(noise=0.02), rng()))


def test_memory_gains_much_where_the_velocity_is_hidden() -> None:
    (gain,) = state_gains(POSITION_ONLY, [positions(record) for record in episodes()], rng())
    assert gain.unexplained > 0.5
    assert gain.low > 5.0


def test_memory_gains_much_where_inputs_act_late() -> None:
    gains = state_gains(TASK, episodes(delay=1), rng())
    assert max(gain.low for gain in gains) > 5.0


def test_the_interval_holds_the_factor() -> None:
    for gain in state_gains(TASK, episodes(noise=0.02), rng()):
        assert gain.low < gain.factor < gain.high


def test_episodes_that_are_too_short_tell_nothing() -> None:
    assert state_gains(TASK, episodes(steps=1), rng()) == ()


def test_rewards_of_the_state_are_told_and_others_are_not() -> None:
    records = episodes()
    assert reward_share(TASK, records, rng()) > 0.99
    random = np.random.default_rng(2)
    drawn = [replace(r, rewards=random.standard_normal(len(r))) for r in records]
    assert reward_share(TASK, drawn, rng()) < 0.2
    equal = [replace(r, rewards=np.ones(len(r))) for r in records]
    assert np.isnan(reward_share(TASK, equal, rng()))
    assert reward_share(POSITION_ONLY, [positions(r) for r in records], rng()) == pytest.approx(
        1.0, abs=0.01
    )
