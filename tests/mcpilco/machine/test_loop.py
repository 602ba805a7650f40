"""Laws of the loop that keeps a machine's time, without a machine."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from mcpilco.machine.loop import Loop
from mcpilco.machine.protocol import Frame, Kind, Status, encode

SESSION = 7


@pytest.fixture
def loop() -> Iterator[Loop]:
    """One that has been welcomed by a machine of an angle and its velocity."""
    told: dict[str, Any] = {
        "key": "",
        "rate": 100.0,
        "states": ["angle", "velocity"],
        "safe": [0.0],
        "thread": threading.get_native_id(),
        "pairs": [(0, 1)],
        "jump": 0.25,
        "homing": 5.0,
        "patience": 5.0,
        "limits": {},
    }
    here, there = socket.socketpair()
    with here, there:
        made = Loop(told, None, here)  # type: ignore[arg-type]
        made._welcomed(Frame(Kind.WELCOME, SESSION, 1, 0, 0, Status.SAFE, (2.0, 1.0)))
        yield made


def believed(loop: Loop, angles: list[float], first: int = 1) -> list[float | None]:
    """The angle that is believed after each measurement, 10 ms apart, of a joint at rest."""
    found = []
    for k, angle in enumerate(angles, first):
        values = (angle, 0.0, 0.0)
        frame = Frame(Kind.MEASUREMENT, SESSION, k, 0, 10_000 * k, Status.READY, values)
        loop._measured(encode(frame, b""))
        found.append(None if loop.sample is None else loop.sample[0])
    return found


STILL = [0.0, 0.0, 0.0, 0.0]
"""believed from the fourth on, which three confirm"""


def test_a_false_angle_is_not_believed(loop: Loop) -> None:
    assert believed(loop, [*STILL, 3.0, 0.1])[3:] == [0.0, 0.0, pytest.approx(0.1)]
    assert loop.counts["jumps"] == 1


def test_a_first_angle_is_believed_when_others_confirm_it(loop: Loop) -> None:
    assert believed(loop, [3.0, *STILL]) == [None, None, None, None, 0.0]


def test_false_angles_are_not_believed_on_the_way_home(loop: Loop) -> None:
    loop._on_begin(1, None)
    assert believed(loop, [0.0, 3.0, 0.0, 0.0, 0.0]) == [None, None, None, None, 0.0]
    assert believed(loop, [0.0, -2.0, 0.0], first=6) == [0.0, 0.0, 0.0]


def test_two_false_angles_that_agree_are_not_believed(loop: Loop) -> None:
    loop._on_begin(1, None)
    assert believed(loop, [*STILL, 2.6, 2.7, 0.0])[3:] == [0.0, 0.0, 0.0, 0.0]


def test_a_machine_that_is_moved_by_hand_on_the_way_home_is_followed(loop: Loop) -> None:
    loop._on_begin(1, None)
    assert believed(loop, [*STILL, 2.0, 2.0, 2.0, 2.0])[3:] == [0.0, 0.0, 0.0, 0.0, 2.0]


def test_the_start_is_told_by_a_measurement_that_is_believed(loop: Loop, monkeypatch) -> None:
    told = []
    monkeypatch.setattr(loop, "_tell", lambda what, **about: told.append((what, about["values"])))
    loop._on_begin(1, None)
    for k, angle in enumerate([2.0] * 4 + STILL, 1):
        status = Status.READY if k > 4 else Status.HOMING
        frame = Frame(Kind.MEASUREMENT, SESSION, k, 0, 10_000 * k, status, (angle, 0.0, 0.0))
        loop._measured(encode(frame, b""))
        loop._home(loop.heard)
    assert told == [("ready", [0.0, 0.0])]
