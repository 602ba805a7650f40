"""Misread columns: in another unit, of another sign, in another's place; another machine's log.

What the plant foretells of short spans of the recordings is compared with what was recorded. Where
it misses much of the motion, the columns are read otherwise, one change after the other. An effect
that a plant lacks is never explained far better by another unit or sign, and nothing is learned
from recordings in which nothing moves.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from mcpilco.plant import Plant
from mcpilco.recordings.recording import Recording
from mcpilco.recordings.suspicion import read_twice, stuck
from mcpilco.typing import InputError


@dataclass(frozen=True)
class MisreadThresholds:
    """When recordings seem to hold a column in another unit, another machine, or nothing.

    Sound recordings of `runs/hidden_effects` miss up to 0.1 with effects of the catalogue, and up
    to 0.65 with a force that is not in it; no other reading of theirs misses less than they do.
    """

    span_s: float = 0.1
    """over which the plant foretells a motion [s]: it changes in that time, and none diverges"""
    smooth_s: float = 0.06
    """to each side, of the cubics that smooth the ends of a span [s]; at least three samples. What
    is sampled more slowly is not smoothed"""
    spans: int = 160
    """that are looked at, of all recordings alike, for the cost"""
    thinned: int = 32
    """one in so many is looked at first where a simulation is dear"""
    swapped: int = 30
    """columns up to which any two may have been swapped, for the cost"""
    moving: float = 3.0
    """noise std by which a state changes over a span from which on it counts"""
    counted: float = 0.9
    """part of the spans that counts: those missed most may hold a push [-]"""
    farthest: float = 1e6
    """largest misfit of a span, in squared changes [-]: a motion that runs away"""
    missed: float = 0.05
    """part of the motion that a plant must miss for its columns to be doubted [-]"""
    better: float = 6.0
    """times as much that it must miss as recorded as with another reading [-]"""
    explained: float = 0.2
    """part of the motion that it may miss with that other reading [-]: effects may lack besides"""
    alike: float = 1.5
    """times the least misfit up to which readings are alike, and the simplest is tried [-]"""
    changes: int = 3
    """of the reading, at most, one after the other"""
    foreign: float = 1.0
    """part of the motion that a plant misses from which on it is another machine's [-]: who says
    that nothing moves misses as much"""
    unforced: float = 0.3
    """part of the motion that springs and friction of any size may leave of a machine's own log
    [-]: arms of `runs/mujoco_plants` leave 0.22 at most, a cart-pole's as a pendulum's 0.40"""
    idle: float = 2.5
    """times as much that a plant must miss with the commands as without them, likewise [-]"""
    inconsistent: float = 0.5
    """part of the motion of a position that its velocity must miss to be no derivative of it [-]"""
    beyond_limit: float = 5.0
    """times the largest command of an actuator from which on commands are in another unit [-]"""
    at_rest: float = 5.0
    """noise std that 95 % of a position's values span at most where it rests; 4 for noise alone"""


MISREAD = MisreadThresholds()

DEGREE = math.pi / 180.0
"""[rad]"""


def misreadings(
    plant: Plant, recordings: Sequence[Recording], limits: Sequence[float] = ()
) -> tuple[str, ...]:
    """Sentences on what is probably wrong with recordings of a plant; none where they are sound.

    Args:
        plant: nominal.
        recordings: of one sampling time, in the plant's states and inputs.
        limits: largest command that each actuator takes, where it is known [its unit].
    """
    told = (*stuck(recordings), *read_twice(recordings))
    spans = Spans.of(recordings)
    if not told and len(spans.within):
        told = tuple(_misread(plant, spans))
    return told or tuple(_beyond_limits(plant, recordings, limits))


def require_plausible(doubts: Sequence[str]) -> None:
    """Raises InputError where there are doubts about the recordings."""
    if doubts:
        raise InputError(
            f"the recordings look wrong: {' '.join(doubts)} Nothing was searched for; mend the "
            "columns, or accept them as they are (--accept)."
        )


def at_rest(recordings: Sequence[Recording], std: Float[np.ndarray, " X"]) -> bool:
    """Whether no position moves by more than its noise, of std in its unit."""
    q = [one.states[:, 0::2] for one in recordings]
    known = [np.where(np.isfinite(each).any(axis=0), each, 0.0) for each in q]
    ends = [np.nanpercentile(each, [2.5, 97.5], axis=0) for each in known]
    return not (np.ptp(ends, axis=1) > MISREAD.at_rest * std[0::2]).any()


def _beyond_limits(
    plant: Plant, recordings: Sequence[Recording], limits: Sequence[float]
) -> Iterator[str]:
    """Inputs whose commands no actuator of the plant takes, with the unit that they suggest."""
    layout = plant.layout
    for u, limit in enumerate(limits):
        largest = max(float(np.abs(one.inputs[:, u]).max()) for one in recordings)
        if not largest > MISREAD.beyond_limit * limit:
            continue
        unit = layout.unit_of(layout.actuator(u))[1]
        yield (
            f"{layout.inputs[u]} is up to {largest:.4g} {unit}, and the actuator takes "
            f"{limit:g} {unit}: is it in m{unit} or c{unit}?"
        )


def _misread(plant: Plant, spans: Spans) -> Iterator[str]:
    """Questions on columns that explain the motion far better if they are read otherwise."""
    start = now = missed(plant, spans)
    time = f"{_lengths(spans.dt)[0] * spans.dt:.2g} s"
    questions = []
    for _ in range(MISREAD.changes):
        if now < MISREAD.missed:
            break
        others = [(missed(plant, other), says, other) for says, other in _tried(plant, spans)]
        least = min((error for error, _, _ in others), default=now)
        if not least < now / MISREAD.better:
            break
        alike = [each for each in others if each[0] <= MISREAD.alike * least]
        questions.append(" or ".join(says for _, says, _ in alike[:2]))
        now, _, spans = alike[0]
    if questions and now < MISREAD.explained:
        yield (
            f"{' '.join(questions)} Read so, the plant misses {_percent(now)} % of the "
            f"motion over {time}; as recorded, {_percent(start)} %."
        )
        return
    yield from _inconsistent(plant, spans)
    first, last = len(plant.layout.states), len(spans.noise)
    without = missed(plant, spans.times(dict.fromkeys(range(first, last), 0.0)))
    foreign = start > min(MISREAD.foreign, max(MISREAD.missed, MISREAD.idle * without))
    if foreign and missed(plant, spans, forces=True) > MISREAD.unforced:
        yield (
            f"the plant misses {_percent(start)} % of the motion over {time}, and without "
            f"the commands {_percent(without)} %: is it the log of another machine, or time in "
            "another unit?"
        )


def _inconsistent(plant: Plant, spans: Spans) -> Iterator[str]:
    """Velocities that are not the derivatives of their positions.

    Of what touches the ground none: an impact between two samples changes a velocity at once.
    """
    if plant.layout.contacts:
        return
    moving = spans.moving(plant)
    for q in np.flatnonzero(moving[0::2] & spans.measured[1 : len(moving) : 2]) * 2:
        moved = spans.within[:, -1, q] - spans.within[:, 0, q]
        wrong = (moved - np.trapezoid(spans.within[..., q + 1], dx=spans.dt, axis=1)) ** 2
        some = np.argsort(wrong)[: math.ceil(MISREAD.counted * len(wrong))]
        if wrong[some].sum() > MISREAD.inconsistent * np.sum(moved[some] ** 2):
            position, velocity = plant.layout.states[q : q + 2]
            yield f"{velocity} is not the derivative of {position}: is it the right column?"


@dataclass(frozen=True)
class Spans:
    """S short spans of the recordings; columns are states, then inputs."""

    ends: Float[np.ndarray, "2 S C"]
    """columns where a span begins and where it ends, smoothed"""
    slopes: Float[np.ndarray, "2 S C"]
    """their time derivatives there"""
    within: Float[np.ndarray, "S n C"]
    """columns as recorded, at both ends and in between"""
    noise: Float[np.ndarray, " C"]
    """std of what the smoothing left over"""
    measured: Bool[np.ndarray, " C"]
    """which columns there are"""
    dt: float
    """sampling time [s]"""

    @classmethod
    def of(cls, recordings: Sequence[Recording]) -> Spans:
        """Spans of all recordings alike."""
        starts = enumerate(span_starts(recordings))
        every = [(k, first) for k, own in starts for first in own]
        some = np.linspace(0, len(every) - 1, min(len(every), MISREAD.spans)).astype(int)
        return cls.at(recordings, [every[k] for k in some])

    @classmethod
    def at(cls, recordings: Sequence[Recording], places: Sequence[tuple[int, int]]) -> Spans:
        """Those that begin at some samples of recordings, by number; cubics smooth their ends."""
        dt, (n, r) = recordings[0].dt, _lengths(recordings[0].dt)
        tables, measured = _tables(recordings)
        spans = np.nan_to_num([tables[k][first - r : first + n + r + 1] for k, first in places])
        spans = spans.reshape(len(places), n + 2 * r + 1, len(measured))
        powers = np.vander(np.arange(-r, r + 1.0), 4, increasing=True)
        around = np.stack([spans[:, : 2 * r + 1], spans[:, n:]])
        cubic = np.einsum("pk,eskc->pesc", np.linalg.pinv(powers), around)
        left = around - np.einsum("kp,pesc->eskc", powers, cubic)
        noise = np.sqrt((left**2).sum(axis=(0, 2)) / (4 * r - 6))
        usual = np.median(noise, axis=0) if len(places) else noise.sum(axis=0)
        ends, steps = cubic[0], cubic[1]
        if dt > MISREAD.smooth_s:  # a cubic through so long a time would miss how a machine turns
            ends, steps = around[:, :, r], 0.5 * (around[:, :, r + 1] - around[:, :, r - 1])
        return cls(ends, steps / dt, spans[:, r : r + n + 1], usual, measured, dt)

    def times(self, factors: Mapping[int, float], shift: float = 0.0) -> Spans:
        """The spans with some columns times a factor, by number, plus a shift."""
        f, o = np.ones(len(self.noise)), np.zeros(len(self.noise))
        f[list(factors)], o[list(factors)] = list(factors.values()), shift
        ends, slopes, within = f * self.ends + o, f * self.slopes, f * self.within + o
        return replace(self, ends=ends, slopes=slopes, within=within, noise=np.abs(f) * self.noise)

    def swapped(self, one: Sequence[int], other: Sequence[int]) -> Spans:
        """The spans with some columns in the place of others."""
        place = np.arange(len(self.noise))
        place[[*one, *other]] = [*other, *one]
        named = "ends", "slopes", "within", "noise", "measured"
        return replace(self, **{name: getattr(self, name)[..., place] for name in named})

    @property
    def few(self) -> Spans:
        """One in some of the spans."""
        n = MISREAD.thinned
        ends, slopes = self.ends[:, ::n], self.slopes[:, ::n]
        return replace(self, ends=ends, slopes=slopes, within=self.within[::n])

    def commands(self, plant: Plant) -> Float[np.ndarray, "S _ U"]:
        """Inputs, each held until the next sample."""
        return self.within[:, :-1, len(plant.layout.states) :]

    def states(self, plant: Plant) -> Float[np.ndarray, "2 S X"]:
        """States at both ends; a velocity without a column is the slope of its position."""
        X = len(plant.layout.states)
        y = self.ends[..., :X].copy()
        for v in range(1, X, 2):
            if not self.measured[v]:
                y[..., v] = self.slopes[..., v - 1]
        return y

    def moving(self, plant: Plant) -> Bool[np.ndarray, " X"]:
        """Which states change by more than their noise."""
        begin, end = self.states(plant)
        noise = np.where(self.measured, self.noise, 0.0)[: begin.shape[1]]
        change = np.sqrt(np.mean((end - begin) ** 2, axis=0))
        return change > np.maximum(MISREAD.moving * noise, 1e-9)


def span_starts(recordings: Sequence[Recording]) -> list[list[int]]:
    """The samples of each at which a span may begin: nothing is missing in it, and beside it.

    A column counts that any of the recordings has.
    """
    n, r = _lengths(recordings[0].dt)
    tables, measured = _tables(recordings)
    whole = [np.isfinite(table[:, measured]).all(axis=1) for table in tables]
    return [
        [
            first
            for part in one.segments()
            for first in range(part.start + r, part.stop - n - r)
            if known[first - r : first + n + r + 1].all()
        ]
        for one, known in zip(recordings, whole, strict=True)
    ]


def _tables(recordings: Sequence[Recording]) -> tuple[list[np.ndarray], Bool[np.ndarray, " C"]]:
    """Their columns, states and then inputs, and which of these any recording has."""
    tables = [np.hstack([one.states, one.inputs]) for one in recordings]
    return tables, np.any([np.isfinite(table).any(axis=0) for table in tables], axis=0)


def _lengths(dt: float) -> tuple[int, int]:
    """Samples of a span, and of the smoothing to each side of its ends."""
    return max(1, round(MISREAD.span_s / dt)), max(3, round(MISREAD.smooth_s / dt))


def missed(plant: Plant, spans: Spans, forces: bool = False) -> float:
    """Part of the squared change of the states over a span that the plant misses, their mean [-].

    1 is what is missed of a machine that is said to stay as it is. States that hardly move do not
    count, nor do the spans that are missed most: they may hold a push or a contact.

    Args:
        plant: nominal.
        spans: of the recordings.
        forces: whether springs, viscous and dry friction and offsets of the joints may be missing,
            as least squares find them. A heavy drive spends most of its force on friction, and the
            wrist of an arm is thrown about by a spring in its shoulder.
    """
    begin, end = spans.states(plant)
    moving = spans.moving(plant)
    if not moving.any():
        return 0.0
    there = plant.simulate(begin, spans.commands(plant), spans.dt)[:, -1]
    size = np.mean((end - begin)[:, moving] ** 2, axis=0)
    rest = there - end
    if forces:
        rest = _without_forces(np.nan_to_num(rest, posinf=0.0, neginf=0.0), 0.5 * (begin + end))
    wrong = np.mean(rest[:, moving] ** 2 / size, axis=1)
    wrong = np.minimum(np.nan_to_num(wrong, nan=np.inf), MISREAD.farthest)
    return float(np.sort(wrong)[: math.ceil(MISREAD.counted * len(wrong))].mean())


def _without_forces(
    rest: Float[np.ndarray, "S X"], at: Float[np.ndarray, "S X"]
) -> Float[np.ndarray, "S X"]:
    """The rest of changes without that of springs, friction and offsets of joints, in states `at`.

    Those of all joints move each of them; of its own one alone where spans are few.
    """
    q, v = at[:, 0::2], at[:, 1::2]

    def left(changes: Float[np.ndarray, "S _"], of: slice) -> Float[np.ndarray, "S _"]:
        D = np.column_stack([np.ones(len(q)), q[:, of], v[:, of], np.sign(v[:, of])])
        found = D @ np.linalg.lstsq(D, changes, rcond=None)[0]
        return (changes - found) / math.sqrt(max(1.0 - D.shape[1] / len(D), 1e-12))

    if 2 * (1 + 3 * q.shape[1]) <= len(q):
        return left(rest, slice(None))
    own = (slice(j, j + 1) for j in range(q.shape[1]))
    return np.hstack([left(rest[:, 2 * j.start : 2 * j.stop], j) for j in own])


def readings(plant: Plant, spans: Spans) -> Iterator[tuple[str, Spans]]:
    """Other meanings of columns, as questions, and the spans so read; the simplest first.

    None in which less moves: it would be easy to explain.
    """
    moving = int(spans.moving(plant).sum())
    yield from (
        each for each in _every_reading(plant, spans) if each[1].moving(plant).sum() >= moving
    )


def _tried(plant: Plant, spans: Spans) -> Iterator[tuple[str, Spans]]:
    """The readings; where a simulation is dear, those by which less is missed of a few spans."""
    every = readings(plant, spans)
    if not plant.costly:
        return every
    less = missed(plant, spans.few) / MISREAD.alike
    return (each for each in every if missed(plant, each[1].few) < less)


def _every_reading(plant: Plant, spans: Spans) -> Iterator[tuple[str, Spans]]:
    layout = plant.layout
    names, X = (*layout.states, *layout.inputs), len(layout.states)
    units = [*layout.units, *(layout.unit_of(layout.actuator(u))[1] for u in range(len(names) - X))]
    joints = [(q, q + 1) for q in range(0, X, 2)]
    known = np.flatnonzero(spans.measured).tolist()
    groups = [(c,) for c in known] + [pair for pair in joints if spans.measured[list(pair)].all()]
    turning = [c for c in known if units[c].startswith("rad")]
    if len(turning) > 2:
        yield "are all angles in degrees?", spans.times(dict.fromkeys(turning, DEGREE))
    for group in groups:
        named = " and ".join(names[c] for c in group)
        verb = "is" if len(group) == 1 else "are"
        for question, factor in _factors(units[group[0]]):
            says = question.format(named=named, verb=verb)
            yield says, spans.times(dict.fromkeys(group, factor))
    for c in plant.angles:
        yield f"is the zero of {names[c]} half a turn away?", spans.times({c: 1.0}, math.pi)
    for a, b in combinations(known, 2) if len(known) <= MISREAD.swapped else ():
        yield f"are {names[a]} and {names[b]} swapped?", spans.swapped([a], [b])
    for one, other in combinations(joints, 2):
        said = f"are the joints of {names[one[0]]} and {names[other[0]]} swapped?"
        yield said, spans.swapped(one, other)


def _factors(unit: str) -> Iterator[tuple[str, float]]:
    """Questions on a column in a unit, and what makes this unit of it."""
    yield "negate {named}?", -1.0
    if unit.startswith("rad"):
        yield "{verb} {named} in degrees?", DEGREE
        yield "{verb} {named} divided by 57.3 once too often?", 1.0 / DEGREE
    for prefix, factor in (("m", 1e-3), ("c", 1e-2), ("h", 1e2), ("k", 1e3)):
        yield "{verb} {named} in " + prefix + unit + "?", factor


def _percent(part: float) -> str:
    return f"{100.0 * part:.0f}" if part >= 10.0 else f"{100.0 * part:.3g}"
