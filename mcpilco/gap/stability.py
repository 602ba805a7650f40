"""Whether the names that an investigation found come back when it is given a little less."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

from mcpilco.gap.investigation import investigate
from mcpilco.gap.report import Gap
from mcpilco.gap.thresholds import DATA
from mcpilco.recordings import reduced

Name = tuple[str, str]
"""an effect and its target"""


@dataclass(frozen=True)
class Repetition:
    """One investigation of a part of the recordings."""

    without: str
    """what it lacked"""
    verdict: str
    names: tuple[Name, ...]
    """that it found"""


@dataclass(frozen=True)
class Stability:
    """How often each name comes back."""

    repetitions: tuple[Repetition, ...]
    first: tuple[Name, ...]
    """names that the investigation of everything found"""

    @property
    def counts(self) -> dict[Name, int]:
        """In how many repetitions each name was found: those of the first, then the others."""
        told = Counter(name for each in self.repetitions for name in each.names)
        return {name: told[name] for name in (*self.first, *(n for n, _ in told.most_common()))}

    def summary(self) -> list[str]:
        """A line for each name."""
        runs = len(self.repetitions)
        lines = [f"The investigation was repeated {runs} times with a part of the recordings:"]
        for (effect, target), count in self.counts.items():
            known = "came back" if (effect, target) in self.first else "was named instead"
            lines.append(f"- {effect} ({target}) {known} in {count} of {runs}")
        return lines if len(lines) > 1 else [*lines, "- nothing was named in any of them"]

    def to_json(self) -> dict[str, Any]:
        """The content of stability.json."""
        names = [
            {"name": name, "target": target, "count": count, "first": (name, target) in self.first}
            for (name, target), count in self.counts.items()
        ]
        return {"names": names, "repetitions": [asdict(each) for each in self.repetitions]}


def repetitions(gap: Gap, **options: Any) -> Stability:
    """Repeats an investigation without each of its recordings, thinned, and begun later.

    Recordings that were held out stay so. `options` are those that `investigate` was called with.
    """
    options = {**options, "held_out": gap.held_out}
    found = []
    for without, left in reduced(gap.recordings, gap.held_out, DATA.later_s):
        again = investigate(gap.plant, left, **options)
        found.append(Repetition(without, again.verdict, _names(again)))
    return Stability(tuple(found), _names(gap))


def _names(gap: Gap) -> tuple[Name, ...]:
    return tuple((each.name, each.target) for each in gap.named)
