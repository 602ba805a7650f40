"""Time stamps that jitter: of the samples, of the commands, or only of the log.

Some loggers stamp the moment at which a sensor was read, some that at which a row was written. A
sample that is put j seconds off its place is v j off the motion, so the motion tells which it was:
it is the rougher one under the wrong reading. When a command went out, with its sample or by a
clock of its own, shows only in what it does to the motion later: `gap` asks its model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from mcpilco.recordings.noise import noise_std
from mcpilco.recordings.recording import Recording
from mcpilco.recordings.resample import Log

STRAY = 0.45
"""a stamp at most so far off an even clock has its place by that clock [steps]"""
MISSED = 2.0
"""ticks a row, at most on average"""
ROWS = 2000
"""that are looked at, from the beginning"""


def by_the_clock(time: Float[np.ndarray, " N"], dt: float) -> Float[np.ndarray, " N"] | None:
    """Times of a clock that ticks each dt, one of its own for each stamp; None if they do not fit.

    Args:
        time: stamps [s], increasing.
        dt: step of the clock [s].
    """
    steps = np.rint(np.diff(time) / dt)
    ticks = np.append(0.0, np.cumsum(steps)) * dt
    late = time - ticks
    offset = float(np.median(late))
    fits = steps.min() >= 1.0 and np.abs(late - offset).max() <= STRAY * dt
    fits &= steps.mean() <= MISSED
    return ticks + offset if fits else None


def readings(log: Log, dt: float, recorded: Callable[[Log], Recording]) -> tuple[Log, ...]:
    """How the stamps of a log may be meant, that in which its samples are smoothest.

    Args:
        log: its rows at the times of their stamps, which are not on a grid.
        dt: its own sampling time [s].
        recorded: what a log becomes on the grid of its sampling time.

    Returns:
        One reading; or two, whose commands went out with the samples, and by a clock.
    """
    clock = by_the_clock(log.time, dt)
    if clock is None:
        return (log,)
    even = replace(log, time=clock - clock[0])
    if _roughness(recorded(even.first(ROWS))) < _roughness(recorded(log.first(ROWS))):
        return (even,)
    return log, replace(log, switched=clock)


def _roughness(recording: Recording) -> float:
    """Geometric mean of the noise of the channels that are measured; infinite if none is known."""
    found = noise_std(recording)
    known = found[np.isfinite(found) & (found > 0.0)]
    return float(np.exp(np.mean(np.log(known)))) if len(known) else np.inf
