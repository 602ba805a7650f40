"""What a piece of work costs in time, also when it stops for others."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True)
class Spent:
    """A time."""

    wall_s: float = 0.0
    """as a clock shows it [s]"""
    cpu_s: float = 0.0
    """of this process, all its threads together [s]"""

    def __add__(self, other: Spent) -> Spent:
        return Spent(self.wall_s + other.wall_s, self.cpu_s + other.cpu_s)

    def __sub__(self, other: Spent) -> Spent:
        return Spent(self.wall_s - other.wall_s, self.cpu_s - other.cpu_s)

    def share(self, among: int) -> Spent:
        """An equal part of it."""
        return Spent(self.wall_s / among, self.cpu_s / among)


class Stopwatch:
    """Runs from when it is made; does not count what lies between `pause` and `resume`."""

    def __init__(self) -> None:
        self._kept = Spent()
        self._since = _now()

    def pause(self) -> None:
        """Stop counting."""
        self._kept = self.read()

    def resume(self, more: Spent) -> None:
        """Go on, with so much added."""
        self._kept += more
        self._since = _now()

    def read(self) -> Spent:
        """What was counted until now."""
        return self._kept + (_now() - self._since)


def _now() -> Spent:
    return Spent(time.perf_counter(), time.process_time())
