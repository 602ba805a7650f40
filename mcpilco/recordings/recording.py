"""A measured time series on a uniform grid: from an episode of an env, and to a file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Self

import numpy as np
from jaxtyping import Bool, Float

from mcpilco.data import Rollout
from mcpilco.recordings.table import write_table
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

Gaps = tuple[tuple[float, float], ...]


class Samples:
    """Base of the dataclasses whose arrays have a row for each of N samples."""

    def _arrays(self) -> dict[str, np.ndarray]:
        found = {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]
        return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}

    def __len__(self) -> int:
        return len(next(iter(self._arrays().values())))

    def __getitem__(self, rows: slice | np.ndarray) -> Self:
        """Some of the samples."""
        chosen = {name: array[rows] for name, array in self._arrays().items()}
        return replace(self, **chosen)  # type: ignore[type-var]

    def thinned(self, most: int) -> Self:
        """At most so many of the samples, at a constant step, thesis section 4.6.1."""
        if len(self) <= most:
            return self
        return self[np.linspace(0, len(self) - 1, most).round().astype(int)]

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """The samples of all parts, one behind the other; all else is that of the first."""
        each = [part._arrays() for part in parts]
        together = {name: np.concatenate([arrays[name] for arrays in each]) for name in each[0]}
        return replace(parts[0], **together)  # type: ignore[type-var]


@dataclass(frozen=True)
class Recording:
    """T samples of a system's states and inputs, as its sensors and its controller logged them."""

    name: str
    """stem of the file"""
    time: Float[np.ndarray, " T"]
    """uniform, from 0 [s]"""
    states: Float[np.ndarray, "T X"]
    """measured, in each state's unit; NaN where a column is absent or a value is masked"""
    inputs: Float[np.ndarray, "T U"]
    """held from time[k] to time[k + 1], in each input's unit; in a gap the last one known"""
    state_names: tuple[str, ...]
    """one for each column of `states`"""
    input_names: tuple[str, ...]
    """one for each column of `inputs`"""
    gaps: Gaps = ()
    """(start, end) on the grid [s]: nothing may be simulated across the open interval, for the
    input is not known in it, or no position was measured for long; the states are NaN in it"""
    remarks: tuple[str, ...] = ()
    """sentences on what was resampled, masked or is suspicious"""
    angles: tuple[int, ...] = ()
    """which states are angles [rad]"""
    velocities: tuple[tuple[int, int], ...] = ()
    """pairs (position, velocity) of states: the second is the time derivative of the first"""
    resolution: tuple[float, ...] = ()
    """step in which each state's log came, in its unit; 0 for none that was seen"""
    held: Float[np.ndarray, "M U"] | None = None
    """the inputs at the rate at which they came, M / T of them a sample; None where none changes
    between two samples: then `inputs` has all, else their means"""
    by_clock: Float[np.ndarray, "M U"] | None = None
    """inputs as they were if they went out by an even clock from which the stamps stray; None where
    there is no doubt"""
    earlier_s: float = 0.0
    """by how much before its sample each position is taken [s]"""

    def __post_init__(self) -> None:
        rows, width = len(self.time), (len(self.state_names), len(self.input_names))
        if self.states.shape != (rows, width[0]) or self.inputs.shape != (rows, width[1]):
            raise InputError(
                f"A recording of {rows} samples expected states of shape {(rows, width[0])} and "
                f"inputs of shape {(rows, width[1])}, got {self.states.shape} and "
                f"{self.inputs.shape}; give one column for each name."
            )
        if not self.resolution:
            object.__setattr__(self, "resolution", (0.0,) * width[0])
        if rows < 2 or not np.allclose(np.diff(self.time), self.dt, rtol=1e-6, atol=0):
            raise InputError(
                "Recording.time must be at least two samples on a uniform grid [s]; "
                "read a log with other time stamps with mcpilco.recordings.read_recording."
            )

    def __len__(self) -> int:
        return len(self.time)

    @property
    def dt(self) -> float:
        """Sampling time [s]."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)

    def driven(self, every: int) -> Float[np.ndarray, "M U"]:
        """The inputs, `every` of them a sample: as they came, or their means over as long."""
        came = self.inputs if self.held is None else self.held
        ends = self.dt * len(self) * np.linspace(0.0, 1.0, len(came) + 1)
        grid = self.dt / every * np.arange(len(self) * every)
        return came if len(came) == len(grid) else mean_held(ends, came, grid, self.dt / every)

    @property
    def every(self) -> int:
        """Inputs a sample, as they came."""
        return 1 if self.held is None else len(self.held) // len(self)

    def from_sample(self, n: int) -> Recording:
        """The recording without its first n samples."""
        late, clock = n * self.dt, self.by_clock
        return replace(
            self,
            time=self.time[n:] - self.time[n],
            states=self.states[n:],
            inputs=self.inputs[n:],
            held=None if self.held is None else self.held[n * self.every :],
            by_clock=None if clock is None else clock[n * (len(clock) // len(self)) :],
            gaps=tuple((max(a - late, 0.0), b - late) for a, b in self.gaps if b > late),
        )

    def without(self, spans: Gaps) -> Recording:
        """The recording with some spans of time [s] as gaps, widened to whole samples."""
        last = len(self) - 1
        ends = [
            (max(math.floor(a / self.dt - 1e-6), 0), min(math.ceil(b / self.dt + 1e-6), last))
            for a, b in spans
            if a < self.time[-1] and b > 0.0
        ]
        lost = np.zeros(last, dtype=bool)  # step k leads from sample k to k + 1
        for start, end in [
            *ends,
            *((round(a / self.dt), round(b / self.dt)) for a, b in self.gaps),
        ]:
            lost[start:end] = True
        states = self.states.copy()
        for start, end in runs(lost):
            states[start + 1 : end] = np.nan
        gaps = tuple((start * self.dt, end * self.dt) for start, end in runs(lost))
        return replace(self, states=states, gaps=gaps)

    def every_nth(self, n: int) -> Recording:
        """One of n samples; the inputs between keep their rate."""
        rows = len(self) // n
        held = self.driven(self.every)[: rows * n * self.every]
        clock = self.by_clock
        step = n * self.dt
        return replace(
            self,
            time=step * np.arange(rows),
            states=self.states[: rows * n : n],
            inputs=held.reshape(rows, -1, held.shape[1]).mean(axis=1),
            held=held,
            by_clock=None if clock is None else clock[: len(clock) // len(self) * rows * n],
            gaps=tuple(
                (step * math.floor(a / step + 1e-6), step * math.ceil(b / step - 1e-6))
                for a, b in self.gaps
                if a < step * (rows - 1)
            ),
        )

    def thinned(self, dt: float) -> Recording:
        """With samples about dt [s] apart, where they are closer; the inputs keep their rate."""
        n = round(dt / self.dt)
        return self.every_nth(n) if n > 1 else self

    @property
    def clocked(self) -> Recording:
        """With the inputs of an even clock, where there is doubt."""
        if self.by_clock is None:
            return self
        means = self.by_clock.reshape(len(self), -1, self.inputs.shape[1]).mean(axis=1)
        return replace(self, inputs=means, held=None if self.held is None else self.by_clock)

    def earlier(self, seconds: float) -> Self:
        """With positions as they were before, by their velocities, or where these lack by slopes.

        A short time [s] is meant, over which a velocity lasts; 0 is as they were read.
        """
        if seconds == self.earlier_s:
            return self
        states, back = self.states.copy(), seconds - self.earlier_s
        for q, v in self.velocities:
            speed, slope = self.states[:, v], np.gradient(self.states[:, q], self.dt)
            states[:, q] -= back * np.where(np.isfinite(speed), speed, slope)
        return replace(self, states=states, earlier_s=seconds)

    @property
    def measured(self) -> Bool[np.ndarray, " X"]:
        """Which states have any measured value."""
        return np.isfinite(self.states).any(0)

    def segments(self) -> tuple[slice, ...]:
        """The stretches of samples between the gaps, each of two samples at least."""
        steps = np.ones(len(self.time) - 1, dtype=bool)  # step k leads from sample k to k + 1
        for start, end in self.gaps:
            steps[round(start / self.dt) : round(end / self.dt)] = False
        return tuple(slice(a, b + 1) for a, b in runs(steps))


def mean_held(
    ends: Float[np.ndarray, " n_plus_1"],
    held: Float[np.ndarray, "n U"],
    grid: Float[np.ndarray, " T"],
    dt: float,
) -> Float[np.ndarray, "T U"]:
    """1/dt times the integral over each step of the grid of a command that is held.

    Each of the commands `held` begins, and the last one ends, at `ends` [s].
    """
    edges = np.append(grid, grid[-1] + dt)
    integral = np.concatenate(
        [np.zeros_like(held[:1]), np.cumsum(held * np.diff(ends)[:, None], 0)]
    )
    columns = [np.diff(np.interp(edges, ends, column)) / dt for column in integral.T]
    return np.column_stack(columns)


def bridged(states: Float[np.ndarray, "T X"]) -> Float[np.ndarray, "T X"]:
    """States with those that are masked on lines between their neighbours, where there are any."""
    rows, whole = np.arange(len(states)), states.copy()
    for x, known in enumerate(np.isfinite(states).T):
        if known.any():
            whole[:, x] = np.interp(rows, rows[known], states[known, x])
    return whole


def runs(flags: Bool[np.ndarray, " T"]) -> list[tuple[int, int]]:
    """First index and end of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def write_recording(path: str | Path, recording: Recording) -> Path:
    """Write a CSV with the header `time,...`; reading it gives the same arrays and gaps.

    A state without any value has no column; a masked value is an empty cell, and so is the input
    in a gap. Equal recordings give equal bytes.

    Raises:
        RunFolderError: the file cannot be written.
    """
    inputs = recording.inputs.copy()
    for start, end in recording.gaps:
        inputs[round(start / recording.dt) : round(end / recording.dt)] = np.nan
    columns = {"time": recording.time}
    for place in np.flatnonzero(recording.measured):
        columns[recording.state_names[place]] = recording.states[:, place]
    columns |= dict(zip(recording.input_names, inputs.T, strict=True))
    return write_table(path, columns)


def from_rollout(name: str, rollout: Rollout, task: TaskSpec) -> Recording:
    """The recording of an episode of T steps on an env: T + 1 samples.

    Angles count turns. The last sample repeats the last input. A state that is not measured is NaN.
    """
    states = np.full((len(rollout.observations), len(task.state_names)), np.nan)
    states[:, list(task.measured_states)] = rollout.observations
    angles = list(task.angles)
    states[:, angles] = np.unwrap(states[:, angles], axis=0)
    return Recording(
        name=name,
        time=rollout.times,
        states=states,
        inputs=np.concatenate([rollout.inputs, rollout.inputs[-1:]]),
        state_names=task.state_names,
        input_names=task.input_names,
        angles=task.angles,
        velocities=task.velocities,
    )


def distinct(recordings: Sequence[Recording]) -> tuple[list[Recording], tuple[str, ...]]:
    """The recordings without those of the same content, and a sentence on each of these."""
    kept: list[Recording] = []
    remarks = []
    for one in recordings:
        same = next((other for other in kept if _same(one, other)), None)
        if same is None:
            kept.append(one)
        else:
            other = "another file" if one.name == same.name else same.name
            remarks.append(f"{one.name} holds the same as {other}: it is counted once.")
    return kept, tuple(remarks)


def _same(one: Recording, other: Recording) -> bool:
    pairs = [(one.time, other.time), (one.states, other.states), (one.inputs, other.inputs)]
    return all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)


def divided(
    recordings: Sequence[Recording], held_out: Sequence[str], most: float, fewest: int
) -> tuple[list[int], list[int]]:
    """Numbers of the recordings to fit, and of those held out: by name, or the last ones.

    Args:
        recordings: all.
        held_out: names of those that are held out; none: the last ones.
        most: part of the samples that these may have [-].
        fewest: recordings below which all are fitted and held out.

    Raises:
        InputError: there are no such names, or nothing is left to fit.
    """
    numbers = list(range(len(recordings)))
    names = [recording.name for recording in recordings]
    if held_out:
        if not set(held_out) < set(names):
            raise InputError(
                f"held_out must be some of the recordings {', '.join(names)}, and leave one to "
                f"fit, got {', '.join(held_out)}."
            )
        unseen = [n for n in numbers if names[n] in held_out]
        return [n for n in numbers if n not in unseen], unseen
    if len(numbers) < fewest:
        return numbers, numbers
    lengths = np.array([len(recording) for recording in recordings])
    after = np.cumsum(lengths[::-1])[::-1] / lengths.sum()  # from each recording to the end
    fits = after <= most
    first = int(np.argmax(fits)) if fits[-1] else -1
    return numbers[:first], numbers[first:]


def reduced(
    recordings: Sequence[Recording], held_out: Sequence[str], later_s: float
) -> Iterator[tuple[str, list[Recording]]]:
    """Each part that may be left out, by name, and the recordings without it.

    It is a recording that is not held out, every second sample, or the first `later_s` [s].
    """
    fitted = [each for each in recordings if each.name not in held_out]
    for gone in fitted if len(fitted) > 1 else ():
        yield gone.name, [each for each in recordings if each is not gone]
    yield "every second sample", [each.every_nth(2) for each in recordings]
    begun = [each.from_sample(round(later_s / each.dt)) for each in recordings]
    yield f"the first {later_s:g} s", begun
