"""Stretches at the ends of a recording in which nothing answers to its commands.

An amplifier is enabled after a log has begun, or switched off before it ends, and what was
commanded meanwhile is logged all the same. A plant foretells short spans of the motion with the
commands and without them. Where a row of spans at an end of a recording is foretold far better
without them, and rows elsewhere are much shorter, the commands did not act there. A joint that
sticks makes such rows everywhere, and tells nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import stats

from mcpilco.plant import Plant
from mcpilco.recordings.misread import MISREAD, Spans, span_starts
from mcpilco.recordings.recording import Gaps, Recording, runs


@dataclass(frozen=True)
class UnpoweredThresholds:
    """When commands count as sent to nothing."""

    worse: float = 4.0
    """times the squared misfit of a span without commands that it has with them [-]: a motor of a
    third of its gain is as far from both"""
    strong: float = 0.25
    """part of the usual change by commands from which on a span tells [-]"""
    longer: float = 2.0
    """times as long as any elsewhere that a row of spans must be [-]: they come in clusters"""
    chance: float = 1e-4
    """probability of such rows at that end of all recordings, were commands of no help there as
    often as elsewhere, below which they are no accident [-]"""
    chance_of_one: float = 0.05
    """the same of the row of one recording, below which it is a gap [-]"""


UNPOWERED = UnpoweredThresholds()


def without_unpowered(
    plant: Plant, recordings: Sequence[Recording]
) -> tuple[list[Recording], tuple[str, ...]]:
    """The recordings with gaps where nothing answers to commands, and a sentence on each gap.

    Args:
        plant: nominal.
        recordings: of one sampling time, in the plant's states and inputs.
    """
    kept, remarks = [], []
    for one, gaps in zip(recordings, unpowered_spans(plant, recordings), strict=True):
        kept.append(one.without(gaps) if gaps else one)
        for start, end in gaps:
            where = f"until {end:.3g} s" if start == 0.0 else f"from {start:.3g} s on"
            remarks.append(
                f"{one.name}: {where} nothing answers to the commands, as if the actuators were "
                "off; nothing is compared there."
            )
    return kept, tuple(remarks)


def unpowered_spans(plant: Plant, recordings: Sequence[Recording]) -> list[Gaps]:
    """Spans of time [s] at the ends of each recording in which nothing answers to its commands."""
    if not recordings:
        return []
    rows = _Rows.of(plant, recordings)
    found: list[list[tuple[float, float]]] = [[] for _ in recordings]
    for first in (True, False):
        lengths = rows.at_end(first)
        chances = rows.usual ** np.array(lengths)
        if stats.combine_pvalues(chances).pvalue >= UNPOWERED.chance:
            continue
        for k, (one, length, chance) in enumerate(zip(recordings, lengths, chances, strict=True)):
            if chance < UNPOWERED.chance_of_one and length >= UNPOWERED.longer * rows.longest:
                starts, last = rows.starts[k], float(one.time[-1])
                if first:
                    found[k].append((0.0, float(one.time[starts[length]])))
                else:
                    found[k].append((float(one.time[starts[-length - 1] + rows.span]), last))
    return [tuple(gaps) for gaps in found]


@dataclass(frozen=True)
class _Rows:
    """Spans of each recording in which its commands would change much, one after the other."""

    starts: list[Int[np.ndarray, " _"]]
    """the samples at which they begin"""
    better: list[Bool[np.ndarray, " _"]]
    """whether they are foretold far better without the commands"""
    span: int
    """samples of one"""

    @classmethod
    def of(cls, plant: Plant, recordings: Sequence[Recording]) -> _Rows:
        """Those of some recordings, side by side."""
        n = max(1, round(MISREAD.span_s / recordings[0].dt))
        starts = [np.array(own[::n], dtype=int) for own in span_starts(recordings)]
        places = [(k, int(at)) for k, own in enumerate(starts) for at in own]
        told = _answers(plant, Spans.at(recordings, places)) if places else np.zeros((2, 0), bool)
        ends = np.cumsum([len(own) for own in starts])[:-1]
        strong, better = (np.split(each, ends) for each in told)
        pairs = [(own[m], b[m]) for own, b, m in zip(starts, better, strong, strict=True)]
        return cls([own for own, _ in pairs], [row for _, row in pairs], n)

    def at_end(self, first: bool) -> list[int]:
        """Lengths of the rows at one end; 0 where commands never help, which tells nothing."""
        ordered = [row if first else row[::-1] for row in self.better]
        return [0 if row.all() else int(np.argmin(row)) for row in ordered]

    @property
    def _elsewhere(self) -> list[Bool[np.ndarray, " _"]]:
        ends = zip(self.better, self.at_end(True), self.at_end(False), strict=True)
        return [row[a : len(row) - b] for row, a, b in ends if not row.all()]

    @property
    def usual(self) -> float:
        """How often a span elsewhere is foretold better without commands [-]."""
        whole = np.concatenate([np.zeros(0, dtype=bool), *self._elsewhere])
        return float((1.0 + whole.sum()) / (2.0 + len(whole)))

    @property
    def longest(self) -> int:
        """The longest row elsewhere."""
        return max((b - a for row in self._elsewhere for a, b in runs(row)), default=0)


def _answers(plant: Plant, spans: Spans) -> tuple[Bool[np.ndarray, " S"], Bool[np.ndarray, " S"]]:
    """Spans in which commands would change much; those that are foretold better without them."""
    begin, end = spans.states(plant)
    moving, commands = spans.moving(plant), spans.commands(plant)
    size = np.maximum(np.mean((end - begin) ** 2, axis=0), 1e-300)

    def apart(one: Float[np.ndarray, "S X"], other: Float[np.ndarray, "S X"]) -> np.ndarray:
        far = np.nan_to_num(one - other, nan=np.inf, posinf=np.inf, neginf=np.inf)
        return ((far**2 / size)[:, moving]).sum(axis=1)

    acted, idle = (
        plant.simulate(begin, held, spans.dt)[:, -1] for held in (commands, 0.0 * commands)
    )
    change = apart(acted, idle)
    strong = change > UNPOWERED.strong * np.median(change)
    return strong, strong & (apart(acted, end) > UNPOWERED.worse * apart(idle, end))
