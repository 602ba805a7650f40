"""Sentences on a recording."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from mcpilco.recordings.noise import noise_std
from mcpilco.recordings.recording import Gaps, Recording
from mcpilco.recordings.resample import Log
from mcpilco.recordings.stamps import on_grid
from mcpilco.recordings.suspicion import longest_rest, unit_ratio

_TURNS_RAD = 50.0  # an angle that spans more is probably in degrees
_COARSE = 2.0  # steps of so many noise standard deviations are told
_FEWEST = 10  # equal samples, before a channel may be stuck


def about_resampling(log: Log, dt: float) -> str:
    """What became of the time stamps."""
    steps = np.diff(log.time)
    low, high = np.quantile(steps, [0.05, 0.95])
    return (
        f"Resampled to a step of {dt:g} s; nine in ten of the log's steps are between "
        f"{low:.3g} and {high:.3g} s."
    )


def about_clock(readings: Sequence[Log], dt: float) -> list[str]:
    """What stamps that jitter are taken for; nothing where they are no clock's."""
    if on_grid(readings[0].time, dt):
        return [f"The time stamps jitter, the samples do not: they are taken every {dt:g} s."]
    if len(readings) > 1:
        return ["The samples jitter as their time stamps do; the commands may have done so or not."]
    return []


def about_gaps(gaps: Gaps) -> list[str]:
    """Where the gaps are."""
    return [
        f"A gap from {start:.3f} to {end:.3f} s: time stamps jump, or values are missing."
        for start, end in gaps
    ]


def suspicions(recording: Recording) -> Iterator[str]:
    """What its reader should look at: units, steps of an encoder, channels that stand still."""
    names, states = recording.state_names, recording.states
    measured, noise = recording.measured, noise_std(recording)
    for q, v in recording.velocities:
        if measured[q] and measured[v]:
            yield from _about_units(recording, q, v)
    for k in recording.angles:
        span = float(np.ptp(states[np.isfinite(states[:, k]), k])) if measured[k] else 0.0
        if span > _TURNS_RAD:
            yield f"{names[k]} spans {span:.0f} rad; is it in degrees?"
    for k in np.flatnonzero(measured).tolist():
        yield from _about_rest(recording, k)
        step = recording.resolution[k]
        if step > _COARSE * noise[k]:
            yield f"{names[k]} comes in steps of {step:.3g}, more than its noise."
    for name, column in zip(recording.input_names, recording.inputs.T, strict=True):
        if np.ptp(column) == 0:
            yield f"{name} is {column[0]:g} throughout; it excites nothing."


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
            f"{recording.state_names[k]} is {column[first]:g} to the last digit from "
            f"{recording.time[first]:.3f} to {recording.time[end - 1]:.3f} s; is it stuck?"
        )
