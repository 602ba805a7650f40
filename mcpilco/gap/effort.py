"""How much may be simulated: steps of the integrator, so that equal data lead to equal results.

A sticking or stiff motion takes a hundred times the steps of a smooth one, and a search that no
model satisfies tries all that it can. What is counted is therefore not the fits but what they cost.
Every stage gets a part of what is left, so that each later one still has something.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from jaxtyping import Int

T = TypeVar("T")

MOST, LEARNING = 6.5e7, 1.5e7
"""steps of the integrator in an investigation; besides, to learn a force"""
USUAL_S = 0.02
"""sampling time from which on this is so [s]; finer recordings take a step from sample to sample"""


@dataclass(frozen=True)
class Effort:
    """The steps that an investigation may take, and those that it has taken."""

    most: float = MOST
    """that it may take"""
    taken: Int[np.ndarray, " 1"] = field(default_factory=lambda: np.zeros(1, dtype=np.int64))
    """counted by the simulation"""

    @classmethod
    def at(cls, dt: float, most: float = MOST) -> Effort:
        """What may be taken with recordings of this sampling time [s]."""
        return cls(most * max(1.0, USUAL_S / dt))

    def share(self, part: float) -> Share:
        """A part of the steps that are left, for a stage that begins now."""
        now = int(self.taken[0])
        return Share(self, now + part * max(self.most - now, 0.0))


@dataclass(frozen=True)
class Share:
    """What one stage may take."""

    effort: Effort
    until: float
    """steps of the whole investigation at which the stage ends"""

    @property
    def used_up(self) -> bool:
        """Whether the stage has to end with what it has."""
        return bool(self.effort.taken[0] >= self.until)

    def lasting(self, items: Iterable[T]) -> Iterator[T]:
        """Items of which the stage treats one after the other: the first, and then while it may."""
        for number, item in enumerate(items):
            if number and self.used_up:
                break
            yield item
