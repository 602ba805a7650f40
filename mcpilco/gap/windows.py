"""Short windows of recordings, each of which is simulated from a start state of its own.

Over half a second to a second an effect that is missing shows far above the noise, and a swinging
pole has not yet forgotten where it started.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from mcpilco.recordings import Recording
from mcpilco.typing import InputError

SECONDS = 1.06
"""length of a window [s]"""
PAST_S = 0.4
"""at least before the first window, for what actuators remember [s]"""
MEMORY_S = 3.0
"""before a window where a recording has it: play remembers its last turn [s]"""
LATENCY_S = 0.06
"""at the start of a window that is not compared: a sensor that lags sees what was before [s]"""
LEAST_MEASURED = 0.8
"""part of the positions that a window must have"""
_BY_WINDOW = "y", "commands", "guess", "recording", "start_s"


@dataclass(frozen=True)
class Windows:
    """W windows of T samples each."""

    y: Float[np.ndarray, "W X T"]
    """measured states; NaN where there is no measurement"""
    commands: Float[np.ndarray, "W T_all U"]
    """held for dt each; `lead` samples of the past come first"""
    lead: int
    """samples before the start"""
    dt: float
    """sampling time [s]"""
    std: Float[np.ndarray, " X"]
    """noise of each state's measurement, in its unit"""
    guess: Float[np.ndarray, "W X"]
    """states at the starts, roughly"""
    recording: Int[np.ndarray, " W"]
    """which recording each is from"""
    start_s: Float[np.ndarray, " W"]
    """when each starts in its recording [s]"""
    overlap: float = 1.0
    """how many windows a sample is in"""

    def __len__(self) -> int:
        return len(self.y)

    def __getitem__(
        self, chosen: Int[np.ndarray, " V"] | Bool[np.ndarray, " W"] | slice
    ) -> Windows:
        """Some of the windows."""
        parts: dict[str, Any] = {name: getattr(self, name)[chosen] for name in _BY_WINDOW}
        return replace(self, **parts)

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

    def beginning(self, samples: int) -> Windows:
        """The first samples of each window."""
        commands = np.ascontiguousarray(self.commands[:, : self.lead + samples])
        return replace(self, y=self.y[:, :, :samples], commands=commands)

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
    seconds: float = SECONDS,
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
    length, past = max(8, round(seconds / dt)), max(1, round(PAST_S / dt))
    lead, stride = round(MEMORY_S / dt), length if every is None else max(1, round(every / dt))
    parts = [
        (number, part.start, first)
        for number, recording in enumerate(recordings)
        for part in recording.segments()
        for first in range(part.start + past, part.stop - length + 1, stride)
        if np.isfinite(recording.states[first : first + length, 0::2]).mean() > LEAST_MEASURED
    ]
    if not parts:
        raise InputError(
            f"the recordings must hold at least {seconds + PAST_S:.2f} s without a gap, "
            f"got {max(len(r) * dt for r in recordings):.2f} s; record longer."
        )
    y = np.stack([recordings[n].states[first : first + length].T for n, _, first in parts])
    guess = np.stack([_start(window, dt, std) for window in y])
    y[:, :, : math.ceil(LATENCY_S / dt)] = np.nan
    commands = [
        recordings[n].inputs[np.maximum(np.arange(first - lead, first + length), begin)]
        for n, begin, first in parts
    ]
    return Windows(
        y=y,
        commands=np.stack(commands),
        lead=lead,
        dt=dt,
        std=std,
        guess=guess,
        recording=np.array([n for n, _, _ in parts]),
        start_s=np.array([first * dt for _, _, first in parts]),
        overlap=max(1.0, length / stride),
    )


def _start(y: Float[np.ndarray, "X T"], dt: float, std: Float[np.ndarray, " X"]) -> np.ndarray:
    """State at the first sample: a cubic through the first samples of each joint."""
    t = dt * np.arange(min(y.shape[1], max(7, round(0.16 / dt))))
    powers = np.stack([t**0, t, t**2, t**3], axis=1)
    slopes = np.stack([0 * t, t**0, 2 * t, 3 * t**2], axis=1)
    start = np.zeros(len(y))
    for j in range(len(y) // 2):
        q, v = y[2 * j, : len(t)], y[2 * j + 1, : len(t)]
        seen, moving = np.isfinite(q), np.isfinite(v)
        rows = np.concatenate([powers[seen] / std[2 * j], slopes[moving] / std[2 * j + 1]])
        goal = np.concatenate([q[seen] / std[2 * j], v[moving] / std[2 * j + 1]])
        start[2 * j : 2 * j + 2] = np.linalg.lstsq(rows, goal, rcond=None)[0][:2]
    return start
