"""What is strange about a channel: spikes, wrapped angles, foreign units, steps of the encoder."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import sliding_window_view

from mcpilco.recordings.recording import runs

_SPIKE = 10.0  # times the usual deviation from a running median
_REACH = 3  # samples that the running median looks to each side: longer spikes are motion
_AROUND = 10  # samples to each side by which a spike is judged
_BUSY = 0.7  # share of the deviation in the busier parts that a quiet part is granted
_BESIDE = 3  # samples to each side through which a cubic goes, as the top of a narrow wave does
_MISSED = 0.8  # least share of a spike's height by which that cubic misses it
_FEWEST_STEPS = 5  # of an encoder, before one believes in it
_MOST_SPIKES = 0.1  # share of the samples; beyond it they are the signal


def spikes(values: Float[np.ndarray, " N"]) -> Bool[np.ndarray, " N"]:
    """Values that stand out from their neighbours for at most three samples.

    The measure is the deviation from a running median of seven samples, which a step, a ramp and a
    turning point leave small; where they are few for a motion, the top of a wave stands out as
    well, but a cubic through the samples beside it tells it. A channel in which a tenth of the
    samples stand out has no spikes.
    """
    known = np.flatnonzero(np.isfinite(values))
    flags = np.zeros(len(values), dtype=bool)
    if len(known) <= 2 * _AROUND:
        return flags
    x = values[known]
    deviation = np.abs(x - np.median(_windows(x, _REACH), axis=1))
    change = np.diff(x, prepend=2 * x[0] - x[1])
    usual = np.maximum(
        1.5 * np.median(deviation) + 0.3 * np.median(np.abs(_windows(change, _AROUND)), axis=1),
        max(quantisation_step(x), _BUSY * np.quantile(deviation, 0.8), 1e-9 * np.ptp(x)),
    )
    found = deviation > _SPIKE * usual
    for start, end in runs(found):
        top = slice(start, end)
        found[top] &= np.abs(x[top] - _bridge(x, found, start, end)) > _MISSED * deviation[top]
    if found.mean() <= _MOST_SPIKES:
        flags[known[found]] = True
    return flags


def _bridge(
    x: Float[np.ndarray, " N"], spiky: Bool[np.ndarray, " N"], start: int, end: int
) -> Float[np.ndarray, " n"]:
    """What a cubic through the samples beside says of those from start to end; else infinity."""
    sound = np.flatnonzero(~spiky)
    before, after = sound[sound < start][-_BESIDE:], sound[sound >= end][:_BESIDE]
    if min(len(before), len(after)) < 2:
        return np.full(end - start, np.inf)
    beside = np.concatenate([before, after])
    cubic = np.polynomial.Polynomial.fit(beside, x[beside], 3)
    return cubic(np.arange(start, end))


def unwrapped(angle: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
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


def quantisation_step(values: Float[np.ndarray, " N"]) -> float:
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


def unit_ratio(
    time: Float[np.ndarray, " N"], q: Float[np.ndarray, " N"], dq: Float[np.ndarray, " N"]
) -> float:
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


def _windows(values: Float[np.ndarray, " N"], reach: int) -> Float[np.ndarray, "N K"]:
    extended = np.pad(values, reach, mode="reflect", reflect_type="odd")  # a ramp goes on
    return sliding_window_view(extended, 2 * reach + 1)
