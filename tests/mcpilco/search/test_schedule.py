"""Laws of the schedule: phases by share of the steps, or by a monitor that settles in time."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from mcpilco.config import Phase, SearchConfig
from mcpilco.search.schedule import DriftMonitor, Schedule


def phases_of(schedule: Schedule, costs) -> list[float]:
    """The learning rate of each step until the schedule ends."""
    rates = []
    for step, cost in enumerate(costs, start=1):
        rates.append(schedule.phase.learning_rate)
        if not schedule.advance(step, cost):
            break
    return rates


def test_a_fixed_schedule_has_its_phases_by_share_of_the_steps() -> None:
    config = SearchConfig(phases=(Phase(3.0, until=0.5), Phase(2.0, until=0.75), Phase(1.0)))
    rates = phases_of(Schedule(config, 20), itertools.repeat(1.0))
    assert rates == [3.0] * 10 + [2.0] * 5 + [1.0] * 5
    assert phases_of(Schedule(config, 1), itertools.repeat(1.0)) == [3.0]


def monitored(steps: int) -> Schedule:
    phases = (Phase(3.0, drift=0.08), Phase(2.0, drift=0.04), Phase(1.0, drift=0.02))
    return Schedule(SearchConfig(phases=phases, monitored=True), steps)


def test_a_monitored_schedule_ends_when_the_cost_has_settled_in_its_last_phase() -> None:
    rates = phases_of(monitored(100_000), itertools.repeat(1.0))
    assert rates == [3.0] * 400 + [2.0] * 200 + [1.0] * 200


def test_a_monitored_schedule_is_over_when_its_steps_are() -> None:
    falling = (1.0 / (1 + 0.01 * step) for step in itertools.count())
    assert phases_of(monitored(300), falling) == [3.0] * 300


def test_the_cost_narrows_to_itself_over_the_first_half() -> None:
    schedule = Schedule(SearchConfig(widening=3.0), 100)
    assert [schedule.widening(step) for step in (0, 25, 50, 99)] == [3.0, 2.0, 1.0, 1.0]
    plain = Schedule(SearchConfig(widening=1.0), 100)
    assert {plain.widening(step) for step in range(100)} == {1.0}


def settled_after(costs) -> int | None:
    monitor = DriftMonitor()
    for step, cost in enumerate(costs, start=1):
        if monitor.update(cost, bound=0.08):
            return step
    return None


@pytest.mark.parametrize("seed", range(5))
def test_the_monitor_settles_on_noise_around_a_constant(seed: int) -> None:
    noise = np.random.default_rng(seed).normal(size=3000)
    step = settled_after(5.0 + noise)
    assert step is not None
    assert step >= 400  # the averages fill for 200 steps, and then it must be calm for 200


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("slope", [-0.2, 0.2])
def test_the_monitor_does_not_settle_on_a_trend(seed: int, slope: float) -> None:
    noise = np.random.default_rng(seed).normal(size=3000)
    assert settled_after(slope * np.arange(3000) + 0.3 * noise) is None


def test_the_monitor_settles_once_a_trend_is_over() -> None:
    noise = 0.3 * np.random.default_rng(0).normal(size=4000)
    costs = np.maximum(0.2 * (1000 - np.arange(4000)), 0.0) + noise
    step = settled_after(costs)
    assert step is not None
    assert 1200 <= step < 3000


def test_the_monitor_passes_over_what_is_not_finite() -> None:
    costs = 5.0 + np.random.default_rng(0).normal(size=1000)
    clean, disturbed = DriftMonitor(), DriftMonitor()
    for cost in costs:
        expected = clean.update(cost, 0.08)
        assert not disturbed.update(math.nan, 0.08)
        assert disturbed.update(cost, 0.08) == expected
    assert vars(disturbed) == vars(clean)


def test_a_new_phase_must_be_calm_for_itself() -> None:
    monitor = DriftMonitor(window=10)
    assert [monitor.update(1.0, 0.1) for _ in range(20)] == [False] * 19 + [True]
    monitor.reset()
    assert [monitor.update(1.0, 0.1) for _ in range(10)] == [False] * 9 + [True]
