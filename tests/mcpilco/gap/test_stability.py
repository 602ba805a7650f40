"""Which names come back when an investigation is given a little less."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from envs.plants import pendulum
from mcpilco.gap import investigate, repetitions
from mcpilco.gap.stability import Named, Repetition, Stability
from mcpilco.recordings import Recording
from tests.mcpilco.gap.pendulum import dry_friction, record
from tests.mcpilco.recordings.test_recording import ten_seconds

BRAKE = Named("coulomb_friction", "pendulum", ("coulomb_friction", "stribeck_friction"))
STRIBECK = Named("stribeck_friction", "pendulum", ("stribeck_friction",))
CABLE = Named("spring", "pendulum", ("spring",))
WINDINGS = Named("armature", "pendulum", ("armature",))


def test_names_are_counted_and_what_agrees_with_them():
    parts = (BRAKE,), (STRIBECK, CABLE), (CABLE,)
    repeated = tuple(Repetition(str(n), "named", named) for n, named in enumerate(parts))
    told = Stability(repeated, (BRAKE, WINDINGS))
    assert told.summary()[1:] == [
        "- coulomb_friction (pendulum) came back in 2 of 3, 1 of them by another name that fits it",
        "- armature (pendulum) came back in 0 of 3",
        "- spring (pendulum) was named instead in 2 of 3",
    ]
    content = told.to_json()
    assert [(n["name"], n["count"], n["alike"]) for n in content["names"]] == [
        ("coulomb_friction", 1, 2),
        ("armature", 0, 0),
    ]
    assert content["instead"] == {"spring (pendulum)": 2}
    assert content["repetitions"][1]["named"][0]["name"] == "stribeck_friction"


def test_the_same_name_at_another_joint_does_not_agree():
    assert BRAKE.agrees(STRIBECK)
    assert not BRAKE.agrees(replace(BRAKE, target="cart"))


def test_repetitions_are_asked_as_the_first_time(monkeypatch: pytest.MonkeyPatch):
    asked: list[dict[str, Any]] = []

    def asking(plant: Any, recordings: list[Recording], **options: Any) -> Any:
        asked.append({"plant": plant, "number": len(recordings), **options})
        return SimpleNamespace(verdict="named", named=[brake] * (len(recordings) == 3))

    monkeypatch.setattr("mcpilco.gap.stability.investigate", asking)
    brake = SimpleNamespace(name=BRAKE.name, target=BRAKE.target, family=BRAKE.family)
    first: Any = SimpleNamespace(
        plant="plant",
        recordings=tuple(ten_seconds(name) for name in "abc"),
        held_out=("c",),
        named=[brake],
    )
    found = repetitions(first, uncertainty=0.02)
    assert [each["number"] for each in asked] == [2, 2, 3, 3]
    assert all(each["held_out"] == ("c",) and each["uncertainty"] == 0.02 for each in asked)
    assert found.counts(BRAKE) == (2, 2)


@pytest.mark.slow
def test_a_friction_comes_back_each_time():
    rng = np.random.default_rng(11)
    recordings = [record(rng, dry_friction(0.1), number) for number in range(4)]
    plant = pendulum()
    found = repetitions(investigate(plant, recordings))
    assert list(map(str, found.first)) == [str(BRAKE)]
    assert found.counts(found.first[0])[1] == len(found.repetitions)
