"""Where a learned force acts: in which joint, and in which region of what was visited."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mcpilco.gap.fit import Fit
from mcpilco.gap.learn import learned_of
from mcpilco.gap.moves import moves_of
from mcpilco.gap.windows import Windows
from mcpilco.plant import LearnedForce

BINS, SEEN, MOST = 80, 3, 0.85
"""of an axis, samples that one needs to count, and part of the squared force, to tell a region"""


@dataclass(frozen=True)
class Place:
    """Where a part of a learned force acts."""

    force: LearnedForce
    largest: float
    """in the recordings, but for one sample in two hundred [N or N m]"""
    share: float
    """of the squared learned force, in usual forces of the joints [-]"""
    within: tuple[tuple[float, float], ...]
    """for each axis, the shortest interval with most of the squared force over what was visited"""


def places(found: Fit, windows: Windows) -> tuple[Place, ...]:
    """The joints and regions of a fit's learned force, the part that does most first."""
    layout = found.model.plant.layout
    names = (*layout.states, *layout.inputs)
    moves = moves_of(found.model, found.theta, windows).reshape(-1, len(names))
    parts = []
    for force in learned_of(found):
        x = [moves[:, names.index(axis.of)] for axis in force.axes]
        size = np.abs(force.at(*x))
        work = np.mean(np.square(size / found.model.scales[force.joint].force))
        visited = [axis.once(places) for axis, places in zip(force.axes, x, strict=True)]
        within = tuple(_shortest(places, size**2) for places in visited)
        parts.append((force, float(np.percentile(size, 99.5)), float(work), within))
    total = sum(work for _, _, work, _ in parts) or 1.0
    told = [Place(force, most, work / total, within) for force, most, work, within in parts]
    return tuple(sorted(told, key=lambda place: -place.share))


def _shortest(x: Float[np.ndarray, " N"], squares: Float[np.ndarray, " N"]) -> tuple[float, float]:
    """The shortest interval with `MOST` of the squares, every part that was visited alike."""
    count, edges = np.histogram(x, BINS)
    total, _ = np.histogram(x, edges, weights=squares)
    mean = np.where(count >= SEEN, total / np.maximum(count, 1), 0.0)
    sums = np.append(0.0, np.cumsum(mean))
    last = np.searchsorted(sums, sums[:-1] + MOST * sums[-1])
    length = np.where(last < len(sums), last - np.arange(BINS), BINS + 1)
    first = int(np.argmin(length))
    return float(edges[first]), float(edges[min(last[first], BINS)])
