"""Whether the names that an investigation found come back when it is given a little less."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

from mcpilco.gap.investigation import investigate
from mcpilco.gap.report import Gap
from mcpilco.gap.thresholds import DATA
from mcpilco.recordings import reduced


@dataclass(frozen=True)
class Named:
    """An effect that an investigation named."""

    name: str
    target: str
    family: tuple[str, ...]
    """what it could be as well, its own name first"""

    def __str__(self) -> str:
        return f"{self.name} ({self.target})"

    def agrees(self, other: Named) -> bool:
        """Whether both could be one effect, though perhaps under two names."""
        return self.target == other.target and not {*self.family}.isdisjoint(other.family)


@dataclass(frozen=True)
class Repetition:
    """One investigation of a part of the recordings."""

    without: str
    """what it lacked"""
    verdict: str
    named: tuple[Named, ...]


@dataclass(frozen=True)
class Stability:
    """How often each name comes back."""

    repetitions: tuple[Repetition, ...]
    first: tuple[Named, ...]
    """what the investigation of everything named"""

    def counts(self, effect: Named) -> tuple[int, int]:
        """Repetitions that named an effect, and those that named it or what agrees with it."""
        same = [str(effect) in map(str, each.named) for each in self.repetitions]
        alike = [any(map(effect.agrees, each.named)) for each in self.repetitions]
        return sum(same), sum(alike)

    @property
    def others(self) -> Counter[str]:
        """In how many repetitions each name was found that agrees with none of the first."""
        found = [effect for each in self.repetitions for effect in each.named]
        return Counter(str(one) for one in found if not any(map(one.agrees, self.first)))

    def summary(self) -> list[str]:
        """A line for each name."""
        runs = len(self.repetitions)
        lines = [f"The investigation was repeated {runs} times with a part of the recordings:"]
        for effect in self.first:
            same, alike = self.counts(effect)
            by = f", {alike - same} of them by another name that fits it" if alike > same else ""
            lines.append(f"- {effect} came back in {alike} of {runs}{by}")
        instead = self.others.most_common()
        lines += [f"- {name} was named instead in {count} of {runs}" for name, count in instead]
        return lines if len(lines) > 1 else [*lines, "- nothing was named in any of them"]

    def to_json(self) -> dict[str, Any]:
        """The content of stability.json."""
        counted = [
            asdict(effect) | dict(zip(("count", "alike"), self.counts(effect), strict=True))
            for effect in self.first
        ]
        repeated = [asdict(each) for each in self.repetitions]
        return {"names": counted, "instead": dict(self.others), "repetitions": repeated}


def repetitions(gap: Gap, **options: Any) -> Stability:
    """Repeats an investigation without each of its recordings, thinned, and begun later.

    Recordings that were held out stay so. `options` are those that `investigate` was called with.
    """
    options = {**options, "held_out": gap.held_out}
    found = []
    for without, left in reduced(gap.recordings, gap.held_out, DATA.later_s):
        again = investigate(gap.plant, left, **options)
        found.append(Repetition(without, again.verdict, _named(again)))
    return Stability(tuple(found), _named(gap))


def _named(gap: Gap) -> tuple[Named, ...]:
    return tuple(Named(each.name, each.target, tuple(each.family)) for each in gap.named)
