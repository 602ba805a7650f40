"""Recordings as short windows, and the problem that they make with a plant.

A window of about a second is simulated from an initial state of its own. Over that time a missing
effect shows far above the noise, and a swinging pole has not diverged yet.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from mcpilco.gap.plant_model import ComputeBudget, PerWindow, PlantModel
from mcpilco.gap.thresholds import BUDGET, COMPARISON, DATA, FORCE
from mcpilco.plant import EffectInstance, Plant, Scale, priors_of, scales_of
from mcpilco.recordings import (
    Recording,
    Whitening,
    divided,
    first_state,
    noise_of,
    states_at_commands,
)
from mcpilco.typing import InputError

_BY_WINDOW = "y", "commands", "path", "guess", "recording", "start_s"


@dataclass(frozen=True)
class Windows:
    """W windows of T samples each."""

    y: Float[np.ndarray, "W X T"]
    """measured states; NaN where there is no measurement"""
    commands: Float[np.ndarray, "W T_all U"]
    """`every` of them a sample, each held as long; `lead` of the past come first"""
    path: Float[np.ndarray, "W T_all X"]
    """states at each command, as smoothed positions have them: what a force remembers at the start
    follows from how the machine came there"""
    lead: int
    """commands before the start"""
    dt: float
    """sampling time [s]"""
    std: Float[np.ndarray, " X"]
    """noise of each state's measurement, in its unit"""
    guess: Float[np.ndarray, "W X"]
    """initial states, roughly"""
    recording: Int[np.ndarray, " W"]
    """which recording each is from"""
    start_s: PerWindow
    """when each starts in its recording [s]"""
    overlap: float = 1.0
    """how many windows a sample is in"""
    every: int = 1
    """commands a sample: what drives a machine keeps its rate, however few samples are compared"""
    whitening: Whitening | None = None
    """of their residuals; None: only the measurement noise counts, which is white"""

    def __len__(self) -> int:
        return len(self.y)

    def __getitem__(
        self, chosen: Int[np.ndarray, " V"] | Bool[np.ndarray, " W"] | slice
    ) -> Windows:
        """Some of the windows."""
        parts: dict[str, Any] = {name: getattr(self, name)[chosen] for name in _BY_WINDOW}
        return replace(self, **parts, whitening=self.whitening and self.whitening.of(chosen))

    def evenly(self, count: int) -> Windows:
        """So many of the windows from all over the recordings, or all where they are no more."""
        return self[np.linspace(0, len(self) - 1, min(count, len(self))).round().astype(int)]

    @property
    def plain(self) -> Windows:
        """The same, of which only the measurement noise counts."""
        return replace(self, whitening=None)

    def of(self, recordings: Sequence[int]) -> Bool[np.ndarray, " W"]:
        """Which windows are from some recordings, by their numbers."""
        return np.isin(self.recording, recordings)

    def joined(self, others: Windows) -> Windows:
        """These windows and others of the same recordings, in the order of time."""
        both: dict[str, Any] = {
            name: np.concatenate([getattr(self, name), getattr(others, name)])
            for name in _BY_WINDOW
        }
        order = np.lexsort([both["start_s"], both["recording"]])
        return replace(self, **{name: part[order] for name, part in both.items()})

    def part(self, first: int, samples: int) -> Windows:
        """Some samples of each window, with all the commands that come before them."""
        driven = slice(first * self.every, self.lead + (first + samples) * self.every)
        commands, path = (np.ascontiguousarray(x[:, driven]) for x in (self.commands, self.path))
        y = self.y[:, :, first : first + samples]
        return replace(self, y=y, commands=commands, path=path, whitening=None)

    @property
    def before(self) -> Float[np.ndarray, "W lead_plus_1 X"]:
        """The states at each command before the start, and at it."""
        return np.ascontiguousarray(self.path[:, : self.lead + 1])

    @property
    def beginning(self) -> int:
        """Samples from which the start of a window is estimated that are to tell the others."""
        return min(round(COMPARISON.start_s / self.dt), self.y.shape[2] // 2)

    @property
    def held_s(self) -> float:
        """For which a command is held [s]."""
        return self.dt / self.every

    @property
    def driven(self) -> Float[np.ndarray, "W T U"]:
        """The mean of the commands from each sample to the next."""
        W, _, T = self.y.shape
        return self.commands[:, self.lead :].reshape(W, T, self.every, -1).mean(axis=2)

    @property
    def measured(self) -> Bool[np.ndarray, "W X T"]:
        """Where there is a measurement."""
        return np.isfinite(self.y)

    @property
    def samples(self) -> Int[np.ndarray, " W"]:
        """Measured values of each window, at least 1."""
        return np.maximum(self.measured.sum(axis=(1, 2)), 1)


def cut(
    recordings: Sequence[Recording],
    std: Float[np.ndarray, " X"],
    seconds: float = DATA.window_s,
    every: float | None = None,
) -> Windows:
    """Windows of recordings with one sampling time.

    Args:
        recordings: of one plant.
        std: noise of each state's measurement, in its unit.
        seconds: length of a window [s].
        every: from the start of one to that of the next [s]; None: they lie side by side.

    Raises:
        InputError: the recordings differ in their sampling time, or are too short for one window.
    """
    dts = {round(recording.dt, 9) for recording in recordings}
    if len(dts) != 1:
        raise InputError(
            f"the recordings must have one sampling time, got {sorted(dts)} s; read them with dt."
        )
    dt = recordings[0].dt
    length, past = max(8, round(seconds / dt)), max(1, round(DATA.past_s / dt))
    stride = length if every is None else max(1, round(every / dt))
    holds = _holds(recordings)
    lead = round(DATA.memory_s / dt) * holds
    driven = [recording.driven(holds) for recording in recordings]
    motions = [states_at_commands(recording, holds) for recording in recordings]
    parts = [
        (number, part.start, first)
        for number, recording in enumerate(recordings)
        for part in recording.segments()
        for first in range(part.start + past, part.stop - length + 1, stride)
        if np.isfinite(recording.states[first : first + length, 0::2]).mean() > DATA.least_measured
    ]
    if not parts:
        raise InputError(
            f"the recordings must hold at least {seconds + DATA.past_s:.2f} s without a gap, "
            f"got {max(len(r) * dt for r in recordings):.2f} s; record longer."
        )
    y = np.stack([recordings[n].states[first : first + length].T for n, _, first in parts])
    guess = np.stack([first_state(window, dt, std) for window in y])
    y[:, :, : math.ceil(DATA.latency_s / dt)] = np.nan
    rows = [
        (n, np.maximum(np.arange(first * holds - lead, (first + length) * holds), begin * holds))
        for n, begin, first in parts
    ]
    return Windows(
        y=y,
        commands=np.stack([driven[n][at] for n, at in rows]),
        path=np.stack([motions[n][at] for n, at in rows]),
        lead=lead,
        dt=dt,
        std=std,
        guess=guess,
        recording=np.array([n for n, _ in rows]),
        start_s=np.array([first * dt for _, _, first in parts]),
        overlap=max(1.0, length / stride),
        every=holds,
    )


def _holds(recordings: Sequence[Recording]) -> int:
    """Commands a sample that a simulation of recordings takes."""
    most = max(1, round(recordings[0].dt / DATA.shortest_hold_s))
    return min(most, max(recording.every for recording in recordings))


def split(windows: Windows, parts: int) -> Windows:
    """Each window as so many shorter ones, one after the other in time."""
    T, each = windows.y.shape[2] // parts, []
    for first in range(0, parts * T, T):
        part = windows.part(first, T)
        guess = np.stack([first_state(window, windows.dt, windows.std) for window in part.y])
        y, start_s = part.y.copy(), windows.start_s + first * windows.dt
        y[:, :, : math.ceil(DATA.latency_s / windows.dt)] = np.nan
        each.append(replace(part, y=y, guess=guess, start_s=start_s))
    return reduce(Windows.joined, each)


def apart(windows: Windows) -> tuple[Windows, Windows]:
    """Two parts of windows in the order of time that share no sample, cut near the middle.

    They are cut between two recordings, or within one where a part would have fewer than
    `DATA.fewest_windows`. Both parts are all windows where that is so even then.
    """
    own, start = windows.recording, windows.start_s
    ends, middle = np.flatnonzero(np.diff(own)) + 1, len(windows) // 2
    enough = ends[np.minimum(ends, len(windows) - ends) >= DATA.fewest_windows]
    first = min(enough, key=lambda end: abs(end - middle), default=middle)
    last, until = own[first - 1], start[first - 1] + windows.y.shape[2] * windows.dt
    second = (own > last) | (own == last) & (start >= until)
    if min(first, second.sum()) < DATA.fewest_windows:
        return windows, windows
    return windows[:first], windows[second]


@dataclass(frozen=True)
class Event:
    """A span of a recording that was left out."""

    recording: str
    """its name"""
    start_s: float
    """from its beginning [s]"""
    end_s: float
    """from its beginning [s]"""


def event_of(
    events: Sequence[Event], windows: Windows, names: Sequence[str]
) -> Int[np.ndarray, " W"]:
    """Number of the event that touches each window of recordings by `names`; -1 where none does."""
    ends = windows.start_s + windows.y.shape[2] * windows.dt
    own = np.array([names[n] for n in windows.recording])
    touched = np.full(len(windows), -1)
    for number, event in enumerate(events):
        inside = (windows.start_s < event.end_s) & (ends > event.start_s)
        touched[(own == event.recording) & inside] = number
    return touched


@dataclass(frozen=True)
class GapProblem:
    """A plant, recordings of it, and the prior knowledge of both."""

    plant: Plant
    """nominal"""
    recordings: tuple[Recording, ...]
    std: Float[np.ndarray, " X"]
    """of the noise of each state, in its unit"""
    priors: Mapping[str, float]
    """relative prior std of each uncertain parameter; inf frees it"""
    train: tuple[int, ...]
    """numbers of the recordings to fit"""
    held_out: tuple[int, ...]
    """numbers of those to compare models on; the same where there are too few"""
    budget: ComputeBudget = field(default_factory=ComputeBudget)
    """integrator steps that it may take, however often data are left out"""
    finer: int = 1
    """times as short a timestep of the plant, so that it does less than the noise"""
    window_s: float = DATA.window_s
    """length of a window [s]"""

    @classmethod
    def of(
        cls,
        plant: Plant,
        recordings: Sequence[Recording],
        uncertainty: float | Mapping[str, float],
        free: Sequence[str],
        noise: Mapping[str, float],
        held_out: Sequence[str] = (),
    ) -> GapProblem:
        """The arguments of `investigate`, checked and completed.

        Raises:
            InputError: the recordings do not fit the plant or one another.
        """
        require_recordings_of(plant, recordings)
        std = noise_of(recordings, noise, plant.angles, DATA.least_noise)
        priors = priors_of(plant, uncertainty, free, DATA.uncertainty)
        train, unseen = divided(recordings, held_out, DATA.held_out, DATA.fewest_to_split)
        most = BUDGET.steps * (BUDGET.costly if plant.costly else 1.0)
        budget = ComputeBudget.at(recordings[0].dt / _holds(recordings), plant.costly, most)
        return cls(plant, tuple(recordings), std, priors, tuple(train), tuple(unseen), budget)

    @property
    def short_s(self) -> float:
        """Length of windows in which a force is sought [s]."""
        return min(self.window_s, FORCE.short_s)

    @property
    def searched(self) -> int:
        """Windows that a search looks at, for its cost."""
        if not self.plant.costly:
            return DATA.searched_windows
        return round(DATA.costly_windows * min(DATA.window_s / self.window_s, DATA.most_of_short))

    @property
    def names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Of the recordings to fit, and of those that are held out; none where all are fitted."""
        every = [recording.name for recording in self.recordings]
        unseen = [n for n in self.held_out if n not in self.train]
        return tuple(every[n] for n in self.train), tuple(every[n] for n in unseen)

    def windows(self, numbers: Sequence[int] | None = None, **how: float) -> Windows:
        """Windows of some recordings, or of all.

        Args:
            numbers: of the recordings; None: all.
            how: as `cut` takes it.
        """
        chosen = self.recordings if numbers is None else [self.recordings[n] for n in numbers]
        windows = cut(chosen, self.std, **({"seconds": self.window_s} | how))
        seen = np.repeat(windows.measured[:, 0::2].any(axis=(0, 2)), 2)
        windows = replace(windows, guess=np.where(seen, windows.guess, self.plant.rest))
        return self._begun_nearer(windows, chosen) if self.plant.costly else windows

    def _begun_nearer(self, windows: Windows, recordings: Sequence[Recording]) -> Windows:
        """With the readings at the start as its guess where the plant is closer from these.

        Where a machine hits the ground its motion is no cubic.
        """
        at = zip(windows.recording, np.round(windows.start_s / windows.dt).astype(int), strict=True)
        read = np.stack([recordings[n].states[k] for n, k in at])
        read = np.where(np.isfinite(read), read, windows.guess)
        plant, few = self.plant, windows.part(0, windows.beginning)
        each, system = np.arange(len(few)), np.zeros(len(few), dtype=np.int64)
        driven = few.commands, few.lead, few.held_s, self.budget.used, few.every
        tables, near = plant.tables(plant.nominal[None]), []
        for start in (windows.guess, read):
            y = plant.beside(plant.run(tables, system, start, each, *driven), few.y)
            r = np.where(few.measured, (y - few.y) / few.std[:, None], 0.0)
            near.append(np.nan_to_num(np.square(r), nan=np.inf).sum(axis=(1, 2)))
        return replace(windows, guess=np.where((near[1] < near[0])[:, None], read, windows.guess))

    def without(self, spans: Sequence[Event]) -> GapProblem:
        """The same with a gap in the recordings at each event."""
        gaps = [
            (*r.gaps, *((s.start_s, s.end_s) for s in spans if s.recording == r.name))
            for r in self.recordings
        ]
        cut_up = (replace(r, gaps=each) for r, each in zip(self.recordings, gaps, strict=True))
        return replace(self, recordings=tuple(cut_up))

    def enough_windows(self) -> Windows:
        """Windows of all recordings, side by side, or where they are few overlapping by half.

        Where a simulation is dear not all of very many.
        """
        windows = self.windows()
        if len(windows) < self.searched:
            return self.windows(every=0.5 * self.window_s)
        return windows.evenly(2 * self.searched) if self.plant.costly else windows

    def model(self, windows: Windows) -> PlantModel:
        """The nominal plant, its uncertain parameters with their priors."""
        nominal = PlantModel(self.plant, (), dict(self.priors), usual_scales(self.plant, windows))
        return replace(nominal, budget=self.budget, finer=self.finer)

    def candidates(self, windows: Windows) -> list[EffectInstance]:
        """Effects that these recordings could show."""
        measured = np.any(windows.measured, axis=(0, 2))
        unseen = {name for x, name in enumerate(self.plant.layout.states) if not measured[x]}
        return [instance for instance in self.plant.candidates() if instance.target not in unseen]


def require_recordings_of(plant: Plant, recordings: Sequence[Recording]) -> None:
    """Raises InputError where there are none, or some have other states or inputs than a plant."""
    if not recordings:
        raise InputError("investigate needs at least one recording, got none.")
    for recording in recordings:
        theirs = recording.state_names, recording.input_names
        ours = plant.layout.states, plant.layout.inputs
        if theirs != ours:
            raise InputError(
                f"the recording {recording.name!r} must have the states and inputs of "
                f"{plant.name}, {', '.join(ours[0] + ours[1])}, got "
                f"{', '.join(theirs[0] + theirs[1])}; read it with the plant's names."
            )


def usual_scales(plant: Plant, windows: Windows) -> dict[str, Scale]:
    """The usual motion and force at each target of a plant in some windows."""
    return scales_of(plant, windows.y, windows.commands, windows.driven, windows.dt)
