"""Events that recur at a place, and such that come at any time."""

from __future__ import annotations

import numpy as np
import pytest

import envs
from mcpilco.gap.events import Event
from mcpilco.gap.given import Given
from mcpilco.gap.recurrence import recurring
from mcpilco.recordings import Recording

DT, SECONDS, COUNT = 0.02, 20.0, 3


@pytest.fixture(scope="module")
def given() -> Given:
    """A pendulum that swings up to 1 rad and back, at a pace that changes."""
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    time = DT * np.arange(round(SECONDS / DT) + 1)
    made = []
    for number in range(COUNT):
        pace = 1.3 + 0.3 * number
        angle = np.sin(pace * time + 0.2 * np.sin(0.7 * time))
        states = np.stack([angle, np.gradient(angle, DT)], axis=1)
        layout = plant.layout
        names = layout.states, layout.inputs
        made.append(Recording(f"r{number}", time, states, np.zeros((len(time), 1)), *names))
    return Given.of(plant, made, 0.01, (), {"angle": 1e-3})


def where(given: Given, low: float, high: float) -> list[Event]:
    """An event for each visit to an interval of the angle."""
    found = []
    for recording in given.recordings:
        inside = (recording.states[:, 0] > low) & (recording.states[:, 0] < high)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
        for first, last in edges.reshape(-1, 2):
            found.append(Event(recording.name, DT * float(first), DT * float(last)))
    return found


def test_what_happens_whenever_a_machine_comes_by_is_told_with_its_place(given: Given) -> None:
    place = recurring(where(given, 0.7, 0.95), given)
    assert place is not None
    assert (place.channel, place.joint) == ("angle", "pendulum")
    low, high = (float(word) for word in place.condition.split() if word[0].isdigit())
    assert 0.3 < low < 0.8 < high < 1.01
    assert 0.5 < place.share <= 1.0


@pytest.mark.parametrize("seed", range(5))
def test_events_at_any_time_are_no_place(given: Given, seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [recording.name for recording in given.recordings]
    spans = [
        Event(str(rng.choice(names)), begin, begin + float(rng.uniform(0.3, 1.5)))
        for begin in map(float, rng.uniform(0.5, SECONDS - 2.0, 6))
    ]
    assert recurring(spans, given) is None


def test_few_events_at_a_place_where_more_visits_are_without_are_none(given: Given) -> None:
    assert recurring(where(given, 0.7, 0.95)[:3], given) is None


def test_without_events_there_is_no_place(given: Given) -> None:
    assert recurring([], given) is None
