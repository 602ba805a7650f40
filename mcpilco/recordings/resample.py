"""From samples at any times to samples on a uniform grid, and what time stamps that jitter mean.

Time stamps say which rows are in order, and the grid that they stand for. Some loggers stamp the
moment at which a sensor was read, some that at which a row was written. A sample that is put j
seconds off its place is v j off the motion, so the motion shows which it was: it is the rougher one
under the wrong reading. When a command went out, with its sample or by a clock of its own, shows
only in what it does to the motion later: `gap` asks its model.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from mcpilco.recordings.recording import Gaps, Recording, Samples, mean_held, runs
from mcpilco.recordings.smoothing import local_fit, noise_std

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

    A round number where one fits: of seconds (0.02), else of samples a second (1/300). Where stamps
    jitter about a clock, a step about twice as long as most is two, between which a row was lost.
    """
    steps = np.diff(time)
    median = float(np.median(steps))
    steps = steps[steps <= JUMP * median]
    mean = float(steps.mean())
    candidates = (_rounded(median), _rounded(mean), mean)
    on = next((dt for dt in candidates if on_grid(time, dt)), None)
    tick = _rounded(float(steps.sum() / np.maximum(np.rint(steps / median), 1.0).sum()))
    return on or (tick if by_the_clock(time, tick) is not None else _rounded(mean))


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


Channel = Float[np.ndarray, " N"]
"""a number a row of the log"""
Held = Float[np.ndarray, "N U"]
"""commands a row of the log"""
Grid = Float[np.ndarray, " T"]
"""a number a sample of the grid"""

LONG = 5
"""more than so many samples of a position in a row without a value are a gap"""
AVERAGED = 5
"""a grid so many times coarser than the log takes local polynomials of it"""


@dataclass(frozen=True)
class Log(Samples):
    """N rows in the order of time, as a file has them."""

    time: Float[np.ndarray, " N"]
    """from 0 [s], increasing"""
    states: Float[np.ndarray, "N X"]
    """NaN where a value is missing"""
    inputs: Float[np.ndarray, "N U"]
    """each held until the next; NaN where a value is missing"""
    switched: Float[np.ndarray, " N"] | None = None
    """from when on each input is held [s], increasing; None: from the time of its row"""

    @property
    def step(self) -> float:
        """Median time between two rows [s]."""
        return float(np.median(np.diff(self.time)))

    def jump(self, dt: float) -> float:
        """The shortest step that counts as a jump of the time stamps [s]."""
        return max(JUMP * self.step, (1 + ON_GRID) * dt)

    def length(self, dt: float) -> int:
        """T, how many samples a grid has up to the last row."""
        return int(np.floor(self.time[-1] / dt + ON_GRID)) + 1


def resampled(
    log: Log, dt: float
) -> tuple[Float[np.ndarray, "T X"], Float[np.ndarray, "T U"], Float[np.ndarray, "M U"] | None]:
    """States and inputs at the times 0, dt, 2 dt, ..., and the inputs at the rate of the log.

    These are None where no input changes between two samples.

    On the grid already: as they are. Else a state is interpolated by the cubic through four
    neighbours, which keeps its noise nearly white, or by a local quadratic where the log has many
    rows a step; and an input is the mean over the step of the command that was held, which keeps
    its impulse and adds no delay. The input where it is missing is the last one known.
    """
    held, grid = _filled(log.inputs), dt * np.arange(log.length(dt))
    switched = log.time if log.switched is None else log.switched
    every = max(1, round(dt / sampling_time(log.time)))
    came = _between(switched, held, len(grid), every, dt) if every > 1 else None
    return _sampled(log, grid, dt), _held(switched, held, grid, dt), came


def _between(
    switched: Channel, held: Held, length: int, every: int, dt: float
) -> Float[np.ndarray, "M U"] | None:
    """`every` commands for each sample of a grid; None where a slow controller holds them all."""
    came = _held(switched, held, dt / every * np.arange(length * every), dt / every)
    changes = np.ptp(came.reshape(length, every, -1), axis=1).max()
    return came if changes > 1e-9 * np.abs(came).max() else None


def _sampled(log: Log, grid: Grid, dt: float) -> Float[np.ndarray, "T X"]:
    if not on_grid(log.time, dt):
        return np.column_stack([_interpolated(log, x, grid, dt) for x in log.states.T])
    states = np.full((len(grid), log.states.shape[1]), np.nan)
    states[np.rint(log.time / dt).astype(int)] = log.states
    return states


def _held(switched: Channel, held: Held, grid: Grid, dt: float) -> Float[np.ndarray, "T U"]:
    if not on_grid(switched, dt):
        ends = np.append(switched, max(switched[-1], grid[-1]) + 2 * dt)
        ends[0] = min(ends[0], grid[0])
        return mean_held(ends, held, grid, dt)
    places = np.rint(switched / dt).astype(int)
    return held[np.maximum(np.searchsorted(places, np.arange(len(grid)), side="right") - 1, 0)]


def find_gaps(
    log: Log, states: Float[np.ndarray, "T X"], positions: tuple[int, ...], dt: float
) -> Gaps:
    """Where nothing may be simulated: the stamps jump, an input or a position is missing for long.

    Returns:
        (start, end) on the grid [s], in order, none touching another.
    """
    last = len(states) - 1
    steps = np.zeros(last, dtype=bool)  # step k leads from sample k to k + 1
    jumps = np.flatnonzero(np.diff(log.time) > log.jump(dt))
    spans = [(log.time[k], log.time[k + 1]) for k in jumps]
    for start, end in runs(np.isnan(log.inputs).any(1)):
        spans.append((log.time[start], log.time[min(end, len(log.time) - 1)]))
    for start, end in spans:
        first = max(int(np.floor(start / dt + ON_GRID)), 0)
        steps[first : max(int(np.ceil(end / dt - ON_GRID)), first + 1)] = True
    for column in states[:, list(positions)].T:
        for start, end in runs(np.isnan(column)):
            if end - start > LONG:
                steps[max(start - 1, 0) : end] = True
    return tuple((dt * a, dt * b) for a, b in runs(steps))


FEW = 0.1
"""most of a log's rows that can be lost; else it follows no clock [-]"""
UNKNOWN_S = 5e-4
"""for which the usual command would do what a guessed one may do wrong [s]"""


def with_lost_rows(log: Log, dt: float) -> tuple[Log, int]:
    """The log with a row where it lost one of a clock that ticks each dt, and how many it lost.

    These rows have no states. Their commands are read off the rows beside by a cubic; they are NaN
    where straight lines from both sides do not meet, as where a command may have jumped.
    """
    lines_up = on_grid(log.time, dt) or by_the_clock(log.time, dt) is not None
    before = (
        np.flatnonzero(np.rint(np.diff(log.time) / dt) == 2.0) if lines_up else np.empty(0, int)
    )
    if not 0 < len(before) <= FEW * len(log.time):
        return log, 0
    rows = np.clip(before[:, None] + np.arange(-1, 3), 0, len(log.time) - 1)
    far, left, right, further = log.inputs[rows].transpose(1, 0, 2)
    apart = 0.5 * np.abs((2.0 * left - far) - (2.0 * right - further))
    usual = np.nanstd(log.inputs, axis=0)
    known = (apart * dt <= UNKNOWN_S * usual).all(axis=1, keepdims=True)
    commands = np.where(known, (2.0 * (left + right) - 0.5 * (far + further)) / 3.0, np.nan)
    return replace(
        log,
        time=np.insert(log.time, before + 1, log.time[rows[:, 1:3]].mean(axis=1)),
        states=np.insert(log.states, before + 1, np.nan, axis=0),
        inputs=np.insert(log.inputs, before + 1, commands, axis=0),
    ), len(before)


def _filled(inputs: Held) -> Held:
    """Each missing input replaced by the last one known, the first ones by the first known."""
    filled = inputs.copy()
    for column in filled.T:
        known = np.flatnonzero(np.isfinite(column))
        latest = np.searchsorted(known, np.arange(len(column)), side="right") - 1
        column[:] = column[known[np.maximum(latest, 0)]]
    return filled


def _interpolated(log: Log, values: Channel, grid: Grid, dt: float) -> Grid:
    """One state on the grid; NaN where its neighbours are far apart or the nearest row lacks it."""
    known = np.isfinite(values)
    time, values = log.time[known], values[known]
    if len(time) < 4:
        return np.full(len(grid), np.nan)
    if dt >= AVERAGED * log.step:
        return _averaged(time, values, grid, dt, log.step)
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    nodes = np.clip(after - 2, 0, len(time) - 4)[:, None] + np.arange(4)
    steps = np.diff(time[nodes], axis=1)
    even = (steps.max(1) <= log.jump(dt)) & (steps.min(1) >= 0.2 * log.step)
    cubic = _through_four(time[nodes], values[nodes], grid)
    result = np.where(even, cubic, np.interp(grid, time, values))
    far = time[after] - time[after - 1] > log.jump(dt)
    near = np.minimum(np.abs(time[after] - grid), np.abs(time[after - 1] - grid)) <= ON_GRID * dt
    outside = (grid < time[0] - ON_GRID * dt) | (grid > time[-1] + ON_GRID * dt)
    result[(far & ~near) | ~known[_nearest(log.time, grid)] | outside] = np.nan
    return result


def _nearest(time: Channel, grid: Grid) -> Int[np.ndarray, " T"]:
    """The row next to each time of the grid."""
    after = np.clip(np.searchsorted(time, grid), 1, len(time) - 1)
    return after - (grid - time[after - 1] < time[after] - grid)


def _through_four(
    nodes: Float[np.ndarray, "T 4"], values: Float[np.ndarray, "T 4"], at: Grid
) -> Grid:
    """Lagrange's cubic through four points."""
    result = np.zeros(len(at))
    for k in range(4):
        others = [j for j in range(4) if j != k]
        weight = np.prod(
            (at[:, None] - nodes[:, others]) / (nodes[:, [k]] - nodes[:, others]), axis=1
        )
        result += weight * values[:, k]
    return result


def _averaged(time: Channel, values: Channel, grid: Grid, dt: float, step: float) -> Grid:
    """Local quadratics of the rows within half a step of each time of the grid."""
    width = min(int(2 * np.ceil(dt / step)) + 1, len(time))
    middle = np.searchsorted(time, grid)
    rows = np.clip(middle - width // 2, 0, len(time) - width)[:, None] + np.arange(width)
    offsets = (time[rows] - grid[:, None]) / dt
    near = np.abs(offsets) <= 0.5 + ON_GRID
    coefficients, _, _ = local_fit(offsets, np.where(near, values[rows], np.nan), 2)
    both_sides = (near & (offsets <= ON_GRID)).any(1) & (near & (offsets >= -ON_GRID)).any(1)
    return np.where(both_sides, coefficients[:, 0], np.nan)


STRAY = 0.45
"""a stamp at most so far off an even clock has its place by that clock [steps]"""
MISSED = 2.0
"""ticks a row, at most on average"""
ROWS = 2000
"""that are looked at, from the beginning"""


def by_the_clock(time: Channel, dt: float) -> Channel | None:
    """Times of a clock that ticks each dt, one of its own for each stamp; None without a fit."""
    steps = np.rint(np.diff(time) / dt)
    ticks = np.append(0.0, np.cumsum(steps)) * dt
    late = time - ticks
    offset = float(np.median(late))
    fits = steps.min() >= 1.0 and np.abs(late - offset).max() <= STRAY * dt
    fits &= steps.mean() <= MISSED
    return ticks + offset if fits else None


def readings(log: Log, dt: float, recorded: Callable[[Log], Recording]) -> tuple[Log, ...]:
    """How the stamps of a log may be meant, that in which its samples are smoothest.

    `recorded` makes of a log what it becomes on the grid of its sampling time.

    Returns:
        One reading; or two, whose commands went out with the samples, and by a clock.
    """
    clock = by_the_clock(log.time, dt)
    if clock is None:
        return (log,)
    even = replace(log, time=clock - clock[0])
    if _roughness(recorded(even[:ROWS])) < _roughness(recorded(log[:ROWS])):
        return (even,)
    return log, replace(log, switched=clock)


def _roughness(recording: Recording) -> float:
    """Geometric mean of the noise of the channels that are measured; infinite if none is known."""
    found = noise_std(recording)
    known = found[np.isfinite(found) & (found > 0.0)]
    return float(np.exp(np.mean(np.log(known)))) if len(known) else np.inf
