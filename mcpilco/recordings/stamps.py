"""Time stamps: which rows are in order, and the uniform grid that they stand for."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from jaxtyping import Float, Int

ON_GRID = 1e-3
"""a stamp this close to the grid is on it [steps]"""
JUMP = 2.5
"""a step longer than so many median steps is a jump of the time stamps"""
_SENSIBLE = 2e-3  # a rounded step may differ from the mean by this share


def increasing(time: Float[np.ndarray, " N"]) -> Int[np.ndarray, " M"]:
    """Indices of a longest strictly increasing subsequence: the rows that are in order."""
    if np.all(np.diff(time) > 0):
        return np.arange(len(time))
    ends: list[float] = []  # the smallest last stamp of a subsequence of each length
    last: list[int] = []
    before = np.full(len(time), -1)
    for k, stamp in enumerate(time.tolist()):
        length = bisect_left(ends, stamp)
        before[k] = last[length - 1] if length else -1
        if length == len(ends):
            ends.append(stamp)
            last.append(k)
        else:
            ends[length], last[length] = stamp, k
    kept, k = [], last[-1]
    while k >= 0:
        kept.append(k)
        k = int(before[k])
    return np.array(kept[::-1])


def sampling_time(time: Float[np.ndarray, " N"]) -> float:
    """The step of the grid on which stamps lie, or near which they jitter [s].

    A round number where one fits: of seconds (0.02), else of samples a second (1/300).
    """
    steps = np.diff(time)
    median = float(np.median(steps))
    mean = float(steps[steps <= JUMP * median].mean())
    candidates = (_rounded(median), _rounded(mean), mean)
    return next((dt for dt in candidates if on_grid(time, dt)), _rounded(mean))


def on_grid(time: Float[np.ndarray, " N"], dt: float) -> bool:
    """True where all stamps, from the first one, are distinct multiples of dt."""
    steps = (time - time[0]) / dt
    places = np.rint(steps)
    return bool(np.all(np.abs(steps - places) <= ON_GRID) and np.all(np.diff(places) > 0))


def _rounded(step: float) -> float:
    """The roundest number near a step, or the step itself."""
    rate = round(1 / step)
    rounded = [float(f"{step:.0e}"), float(f"{step:.1e}"), 1 / rate if rate else 0.0]
    return next((near for near in rounded if abs(near - step) <= _SENSIBLE * step), step)
