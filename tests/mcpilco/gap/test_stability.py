"""Which names come back when an investigation is given a little less."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from envs.plants import pendulum
from mcpilco.gap import investigate, repetitions
from mcpilco.gap.stability import Repetition, Stability
from mcpilco.recordings import Recording
from tests.mcpilco.gap.pendulum import dry_friction, record
from tests.mcpilco.recordings.test_recording import ten_seconds

BRAKE, CABLE = ("coulomb_friction", "pendulum"), ("spring", "pendulum")


def test_names_are_counted_those_of_everything_first():
    told = Stability(
        (Repetition("one", "named", (BRAKE,)), Repetition("two", "named", (BRAKE, CABLE))),
        (BRAKE, ("armature", "pendulum")),
    )
    assert list(told.counts.values()) == [2, 0, 1]
    assert told.summary()[1:] == [
        "- coulomb_friction (pendulum) came back in 2 of 2",
        "- armature (pendulum) came back in 0 of 2",
        "- spring (pendulum) was named instead in 1 of 2",
    ]
    assert [entry["first"] for entry in told.to_json()["names"]] == [True, True, False]


def test_repetitions_are_asked_as_the_first_time(monkeypatch: pytest.MonkeyPatch):
    asked: list[dict[str, Any]] = []

    def asking(plant: Any, recordings: list[Recording], **options: Any) -> Any:
        asked.append({"plant": plant, "number": len(recordings), **options})
        named = SimpleNamespace(name=BRAKE[0], target=BRAKE[1])
        return SimpleNamespace(verdict="named", named=[named] * (len(recordings) == 3))

    monkeypatch.setattr("mcpilco.gap.stability.investigate", asking)
    first: Any = SimpleNamespace(
        plant="plant",
        recordings=tuple(ten_seconds(name) for name in "abc"),
        held_out=("c",),
        named=[SimpleNamespace(name=BRAKE[0], target=BRAKE[1])],
    )
    found = repetitions(first, uncertainty=0.02)
    assert [each["number"] for each in asked] == [2, 2, 3, 3]
    assert all(each["held_out"] == ("c",) and each["uncertainty"] == 0.02 for each in asked)
    assert found.counts == {BRAKE: 2}


@pytest.mark.slow
def test_a_friction_comes_back_each_time():
    rng = np.random.default_rng(11)
    recordings = [record(rng, dry_friction(0.1), number) for number in range(4)]
    plant = pendulum()
    found = repetitions(investigate(plant, recordings))
    assert found.first == (BRAKE,)
    assert set(found.counts.values()) == {len(found.repetitions)}
