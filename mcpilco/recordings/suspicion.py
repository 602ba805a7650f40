"""Suspicious channels of a recording: spikes, wrapped angles, foreign units, encoder steps."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.lib.stride_tricks import sliding_window_view

from mcpilco.recordings.recording import Gaps, Recording, Samples, runs
from mcpilco.recordings.resample import Channel, Log, on_grid
from mcpilco.recordings.smoothing import noise_std

_REACH = 3  # samples that windows look to each side: what lasts longer is motion
_AROUND = 10  # samples to each side by which a spike is judged
_LIKELY = 10.0  # times the usual deviation from a running median of what may be a spike
_BUSY = 0.7  # share of the deviation in the busier parts that a quiet part is granted
_BESIDE = 3  # samples to each side through which a cubic goes, as the top of a narrow wave does
_MISSED = 0.8  # least share of a spike's height by which that cubic misses it
_SPIKE = 5.0  # times as rough as all else around it, and as nearly all of the channel, is a spike
_NEARLY = 0.98  # of the channel
_SIXTH = np.array([1, -6, 15, -20, 15, -6, 1]) / 20.0  # a sample less the quintic beside it
_FEWEST_STEPS = 5  # of an encoder, before one believes in it
_MOST_SPIKES = 0.1  # share of the samples; beyond it they are the signal


@dataclass(frozen=True)
class Partner(Samples):
    """The other column of a joint, which tells a fast motion from a value that was read wrongly."""

    time: Channel
    """of the samples [s]"""
    values: Channel
    """positions beside a velocity, or velocities beside a position"""
    positions: bool
    """whether it is the first of these"""

    def confirms(self, x: Channel, bridged: Channel, start: int, end: int) -> bool:
        """Whether the motion is nearer to x from start to end than to a bridge over it."""
        span = slice(start - 1, end + 1 if self.positions else start + 1)
        rates = np.stack([x, bridged] if self.positions else [self.values])[:, span]
        moved = 0.5 * (rates[:, 1:] + rates[:, :-1]) @ np.diff(self.time[span])
        if self.positions:
            gone, (said, instead) = self.values[end] - self.values[start - 1], moved
        else:
            (gone,), (said, instead) = moved, (y[start] - x[start - 1] for y in (x, bridged))
        return bool(abs(gone - said) < 0.5 * abs(instead - said))


def spikes(values: Channel, partner: Partner | None = None) -> Bool[np.ndarray, " N"]:
    """Values read wrongly: they leave their neighbours and come back within three samples.

    A motion may do so too where samples are few for it, an encoder's velocity with each count. Then
    what is beside is rough as well, or such things are usual in the channel, or the joint's other
    column has them. A spike is far higher than the sixth differences beside it, and than nearly all
    of the channel, and the other column knows nothing of it. Where a tenth of the samples stand
    out, none are spikes.

    Values are NaN where one is missing; the partner is the joint's other column.
    """
    known = np.flatnonzero(np.isfinite(values))
    flags = np.zeros(len(values), dtype=bool)
    if len(known) <= 2 * _AROUND:
        return flags
    x, beside = values[known], None if partner is None else partner[known]
    found = _standing_out(x)
    if found.mean() <= _MOST_SPIKES:
        flags[known[_spikes_among(found, x, beside)]] = True
    return flags


def _standing_out(x: Channel) -> Bool[np.ndarray, " N"]:
    """Samples that a running median and a cubic through those beside miss by far."""
    deviation = np.abs(x - np.median(_windows(x, _REACH), axis=1))
    change = np.diff(x, prepend=2 * x[0] - x[1])
    usual = np.maximum(
        1.5 * np.median(deviation) + 0.3 * np.median(np.abs(_windows(change, _AROUND)), axis=1),
        max(quantisation_step(x), _BUSY * np.quantile(deviation, 0.8), 1e-9 * np.ptp(x)),
    )
    found = deviation > _LIKELY * usual
    found[:2] = found[-2:] = False  # nothing is known of one side
    sound = np.flatnonzero(~found)
    for start, end in runs(found):
        top = slice(start, end)
        found[top] &= np.abs(x[top] - _bridge(x, sound, start, end)) > _MISSED * deviation[top]
    return found


def _spikes_among(
    found: Bool[np.ndarray, " N"], x: Channel, partner: Partner | None
) -> Bool[np.ndarray, " N"]:
    """Those of the samples that stand out which are spikes; the others show what is usual."""
    least = _LIKELY * max(quantisation_step(x), 1e-9 * np.ptp(x))
    while found.any():
        bridged, kept, sound = x.copy(), found.copy(), np.flatnonzero(~found)
        for start, end in runs(found):
            bridged[start:end] = _bridge(x, sound, start, end)
        rough = np.abs(_windows(bridged, _REACH) @ _SIXTH)
        usual = _SPIKE * np.quantile(rough[~found], _NEARLY)
        for start, end in runs(found):
            around = _SPIKE * rough[max(0, start - _AROUND) : end + _AROUND].max()
            spike = _height(x, bridged, start, end) > max(around, usual, least)
            spike &= partner is None or not partner.confirms(x, bridged, start, end)
            kept[start:end] = spike and end - start <= _REACH
        if (kept == found).all():
            break
        found = kept
    return found


def _height(x: Channel, bridged: Channel, start: int, end: int) -> float:
    """How far x from start to end is beyond the two samples on both sides, and off the bridge."""
    top, beside = x[start:end], np.concatenate([x[start - 2 : start], x[end : end + 2]])
    beyond = np.maximum(top - beside.max(), beside.min() - top)
    return float(min(beyond.min(), np.abs(top - bridged[start:end]).min()))


def _bridge(
    x: Channel, sound: Int[np.ndarray, " M"], start: int, end: int
) -> Float[np.ndarray, " n"]:
    """A cubic through the sound samples beside, by number, at those from start to end."""
    first = int(np.searchsorted(sound, start))
    beside = sound[first - min(first, _BESIDE) : first + _BESIDE]
    return np.polynomial.Polynomial.fit(beside, x[beside], 3)(np.arange(start, end))


def unwrapped(angle: Channel) -> Channel:
    """The angle [rad], counting turns where the log had it wrapped to one turn."""
    known = np.isfinite(angle)
    values = angle[known]
    if len(values) < 2 or not np.any(np.abs(np.diff(values)) > np.pi):
        return angle
    low, high = np.quantile(values, [0.005, 0.995])
    if high - low > 2.05 * np.pi:
        return angle  # it counts turns already; a jump in it is something else
    result = angle.copy()
    result[known] = np.unwrap(values)
    return result


def quantisation_step(values: Channel) -> float:
    """The step of which all differences are multiples, in the channel's unit; 0 for none.

    A step as fine as the rounding of a text file counts too; it does no harm.
    """
    distinct = np.unique(values[np.isfinite(values)])
    if len(distinct) < 2:
        return 0.0
    steps = np.diff(distinct)
    steps = steps[steps > 1e-9 * np.ptp(distinct)]  # less is the rounding of the computer
    steps = steps[steps > 0.02 * np.median(steps)]  # less is the rounding of the text
    step = float(steps.min())
    multiples = steps / step
    small = multiples < 10  # beyond it the rounding of the step itself counts
    whole = np.abs(multiples - np.rint(multiples))[small] < 0.05
    if len(whole) < max(_FEWEST_STEPS, len(steps) / 2) or whole.mean() < 0.95:
        return 0.0
    return float(np.median(steps[small] / np.rint(multiples[small])))


def unit_ratio(time: Channel, q: Channel, dq: Channel) -> float:
    """How many times the derivative of the position the logged velocity is; NaN if it rests."""
    known = np.isfinite(q) & np.isfinite(dq)
    t, q, dq = time[known], q[known], dq[known]
    if len(t) < 3:
        return np.nan
    travelled = np.concatenate([[0.0], np.cumsum(np.diff(t) * (dq[1:] + dq[:-1]) / 2)])
    reach = min(25, len(t) - 1)
    moved, claimed = q[reach:] - q[:-reach], travelled[reach:] - travelled[:-reach]
    power = float(moved @ moved)
    return float(moved @ claimed) / power if power > 0 else np.nan


def longest_rest(values: Float[np.ndarray, " T"]) -> tuple[int, int]:
    """First sample and end of the longest run of exactly equal values."""
    return max(
        ((a, b + 1) for a, b in runs(np.diff(values) == 0)),
        key=lambda run: run[1] - run[0],
        default=(0, 0),
    )


def _windows(values: Channel, reach: int) -> Float[np.ndarray, "N K"]:
    extended = np.pad(values, reach, mode="reflect", reflect_type="odd")  # a ramp goes on
    return sliding_window_view(extended, 2 * reach + 1)


_TURNS_RAD = 50.0  # an angle that spans more is probably in degrees
_COARSE = 2.0  # steps of so many noise standard deviations are remarked on
_FEWEST = 10  # equal samples, before a channel may be stuck
_USUAL = 0.99  # of an input's samples
_SURGE = 4.0  # times as large as nearly all of an input, it stands out


def about_resampling(log: Log, dt: float) -> str:
    """A remark on the new step and the steps of the log."""
    steps = np.diff(log.time)
    low, high = np.quantile(steps, [0.05, 0.95])
    return (
        f"Resampled to a step of {dt:g} s; nine in ten of the log's steps are between "
        f"{low:.3g} and {high:.3g} s."
    )


def about_clock(readings: Sequence[Log], dt: float) -> list[str]:
    """A remark on which of samples and commands jitter; none where stamps follow no clock."""
    if on_grid(readings[0].time, dt):
        return [f"The time stamps jitter, the samples do not: they are taken every {dt:g} s."]
    if len(readings) > 1:
        return ["The samples jitter as their time stamps do; the commands may have done so or not."]
    return []


def about_lost_rows(count: int) -> list[str]:
    """A remark on rows that a log lost, one at a time."""
    if not count:
        return []
    rows = "1 row is" if count == 1 else f"{count} rows are"
    return [f"{rows} missing, by the clock of the others; commands in between are read off these."]


def about_gaps(gaps: Gaps) -> list[str]:
    """Where the gaps are."""
    return [
        f"A gap from {start:.3f} to {end:.3f} s: time stamps jump, or values or a command are "
        "not known."
        for start, end in gaps
    ]


def suspicions(recording: Recording) -> Iterator[str]:
    """Remarks on channels: doubtful ones, steps of an encoder, inputs that never change."""
    yield from doubts(recording)
    names, noise = recording.state_names, noise_std(recording)
    for k in np.flatnonzero(recording.measured).tolist():
        step = recording.resolution[k]
        if step > _COARSE * noise[k]:
            yield f"{names[k]} comes in steps of {step:.3g}, more than its noise."
    for name, column in zip(recording.input_names, recording.inputs.T, strict=True):
        if np.ptp(column) == 0:
            yield f"{name} is {column[0] + 0.0:g} throughout; it excites nothing."


def doubts(recording: Recording) -> Iterator[str]:
    """Sentences on columns that look wrong: units, channels that stand still, spikes of inputs."""
    names, states = recording.state_names, recording.states
    measured = recording.measured
    for q, v in recording.velocities:
        if measured[q] and measured[v]:
            yield from _about_units(recording, q, v)
    for k in recording.angles:
        span = float(np.ptp(states[np.isfinite(states[:, k]), k])) if measured[k] else 0.0
        if span > _TURNS_RAD:
            yield f"{names[k]} spans {span:.0f} rad; is it in degrees?"
    for k in np.flatnonzero(measured).tolist():
        yield from _about_rest(recording, k)
    for name, column in zip(recording.input_names, recording.inputs.T, strict=True):
        usual = float(np.quantile(np.abs(column), _USUAL))
        high = np.abs(column) > _SURGE * usual
        if usual > 0.0 and high.any():
            most, first = column[np.abs(column).argmax()], recording.time[high.argmax()]
            yield (
                f"{name} is {most:.3g} at most, from {first:.3f} s on, and within {usual:.3g} in "
                f"{100 * _USUAL:.0f} % of the samples; was it so?"
            )


def unchanging(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence where no command ever changes; what then moves, moves by itself."""
    commands = np.concatenate([one.inputs for one in recordings])
    if (np.ptp(commands, axis=0) > 0.0).any():
        return ()
    named = zip(recordings[0].input_names, commands[0], strict=True)
    held = " and ".join(f"{name} is {value + 0.0:g}" for name, value in named)  # no -0
    return (f"{held} throughout, which excites nothing: is it the right column?",)


def stuck(recordings: Sequence[Recording]) -> Iterator[str]:
    """Columns of states that keep one value throughout while others move."""
    first = recordings[0]
    measured = [x for x in range(len(first.state_names)) if first.measured[x]]
    table = np.concatenate([one.states for one in recordings])[:, measured]
    still = np.nanmax(table, axis=0) == np.nanmin(table, axis=0)
    for x in np.flatnonzero(still & (not still.all())).tolist():
        stands = f"{first.state_names[measured[x]]} is {table[0, x] + 0.0:g} throughout"
        yield f"{stands} while others move: is it the right column?"


def read_twice(recordings: Sequence[Recording]) -> Iterator[str]:
    """States that hold the same values as another column, and move."""
    first = recordings[0]
    X, names = len(first.state_names), (*first.state_names, *first.input_names)
    table = np.concatenate([np.hstack([one.states, one.inputs]) for one in recordings])
    for x, other in combinations(range(len(names)), 2):
        same = x < X and np.array_equal(table[:, x], table[:, other])
        if same and np.ptp(table[:, x]) > 0.0:
            yield f"{names[x]} and {names[other]} hold the same values: is a column read twice?"


def _about_units(recording: Recording, q: int, v: int) -> Iterator[str]:
    ratio = unit_ratio(recording.time, recording.states[:, q], recording.states[:, v])
    if math.isfinite(ratio) and not 0.8 < ratio < 1.25:
        position, velocity = recording.state_names[q], recording.state_names[v]
        yield (
            f"{velocity} is {ratio:.3g} times the derivative of {position}; "
            "check units (degrees are 57.3 times radians), sign and columns."
        )


def _about_rest(recording: Recording, k: int) -> Iterator[str]:
    """A remark where a channel stands still to the last digit while its partner or input moves."""
    column = recording.states[:, k]
    first, end = longest_rest(column)
    if (end - first) * recording.dt < 0.5 or end - first < _FEWEST:
        return
    others = [v if k == q else q for q, v in recording.velocities if k in (q, v)]
    moving = [
        np.ptp(recording.states[first:end, j]) > 0.2 * np.nanmax(np.abs(recording.states[:, j]))
        for j in others
        if recording.measured[j] and np.isfinite(recording.states[first:end, j]).all()
    ]
    if end - first >= np.isfinite(column).sum() or any(moving):
        yield (
            f"{recording.state_names[k]} is {column[first] + 0.0:g} to the last digit from "
            f"{recording.time[first]:.3f} to {recording.time[end - 1]:.3f} s; is it stuck?"
        )
