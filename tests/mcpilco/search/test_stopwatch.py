"""Laws of the stopwatch: what lies in a pause is not counted, what is added is."""

from __future__ import annotations

import time

import pytest

from mcpilco.search.stopwatch import Spent, Stopwatch


def test_a_pause_is_not_counted_and_what_is_added_is(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([10.0, 13.0, 100.0, 104.0])
    monkeypatch.setattr(time, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(time, "process_time", lambda: 0.0)
    watch = Stopwatch()
    watch.pause()
    watch.resume(Spent(wall_s=0.5, cpu_s=2.0))
    assert watch.read() == Spent(3.0 + 0.5 + 4.0, 2.0)


def test_shares_make_the_whole() -> None:
    whole = Spent(6.0, 3.0)
    assert whole.share(3) + whole.share(3) + whole.share(3) == whole
