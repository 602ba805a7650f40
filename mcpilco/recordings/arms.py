"""Recordings of an arm: their columns, and the samples that they hold.

Nothing is resampled, and nothing that stands out is masked, for a push may begin as one sample that
does.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mcpilco.recordings.reader import LogRows, read_rows
from mcpilco.recordings.recording import Samples
from mcpilco.recordings.resample import sampling_time
from mcpilco.typing import InputError, RecordingError

WINDOW = 3
"""samples over which a derivative is taken"""


@dataclass(frozen=True)
class ArmSamples(Samples):
    """N samples of J joints; those of several recordings stand one behind the other."""

    time: Float[np.ndarray, " N"]
    """since the start of its recording [s]"""
    q: Float[np.ndarray, "N J"]
    """position [rad or m]"""
    dq: Float[np.ndarray, "N J"]
    """velocity"""
    ddq: Float[np.ndarray, "N J"]
    """acceleration, of velocities up to this sample"""
    eq: Float[np.ndarray, "N J"]
    """error of position: target less measurement"""
    deq: Float[np.ndarray, "N J"]
    """error of velocity"""
    ic: Float[np.ndarray, "N J"]
    """current that the controller asks for [A]"""
    i: Float[np.ndarray, "N J"]
    """current measured [A]"""

    @property
    def standard(self) -> Float[np.ndarray, "N D"]:
        """x = [q, q', q''], thesis section 4.4.1."""
        return np.hstack([self.q, self.dq, self.ddq])

    @property
    def augmented(self) -> Float[np.ndarray, "N D"]:
        """[q, q', q'', e_q, e_q', i_c], thesis eq. (4.8)."""
        return np.hstack([self.standard, self.eq, self.deq, self.ic])


def slopes(x: Float[np.ndarray, "N J"], dt: float, window: int) -> Float[np.ndarray, "N J"]:
    """Slope of the straight line through the last `window` samples of x; NaN at the first ones."""
    found = np.full_like(x, np.nan)
    if len(x) >= window:
        seen = np.lib.stride_tricks.sliding_window_view(x, window, axis=0)
        found[window - 1 :] = seen @ _slope_weights(dt, window)
    return found


def _slope_weights(dt: float, window: int) -> Float[np.ndarray, " W"]:
    """Least squares: sum_k (k - mean) x_k / sum_k (k - mean)^2 / dt."""
    k = np.arange(window) - 0.5 * (window - 1)
    return k / (k @ k) / dt


class RunningSlope:
    """`slopes`, one sample at a time."""

    def __init__(self, dt: float, window: int) -> None:
        self._weights = _slope_weights(dt, window)
        self._last: deque[np.ndarray] = deque(maxlen=window)

    def __call__(self, x: Float[np.ndarray, " J"]) -> Float[np.ndarray, " J"]:
        """The slope up to this sample; NaN as long as there are too few."""
        self._last.append(x)
        if len(self._last) < len(self._weights):
            return np.full_like(x, np.nan)
        return self._weights @ np.stack(self._last)

    def reset(self) -> None:
        """Forgets all samples."""
        self._last.clear()


COLUMNS = (
    "position",
    "velocity",
    "current",
    "target_position",
    "target_velocity",
    "target_current",
)
"""of each joint, as `<joint>_<column>`; those of velocities may be absent"""
_LATE = 1.5
"""sampling times after which a sample does not follow on the one before [-]"""
_KNOWN = 0.5
"""share of the samples at which all must be known [-]"""


@dataclass(frozen=True)
class ArmRecording:
    """T samples of J joints, of a file, a driver or a simulated arm; NaN where a cell is empty."""

    name: str
    """stem of the file, or whose samples these are"""
    time: Float[np.ndarray, " T"]
    """from 0, increasing [s]"""
    position: Float[np.ndarray, "T J"]
    """[rad or m]"""
    velocity: Float[np.ndarray, "T J"]
    """[rad/s or m/s]; NaN where the file has none"""
    current: Float[np.ndarray, "T J"]
    """[A]"""
    target_position: Float[np.ndarray, "T J"]
    """[rad or m]"""
    target_velocity: Float[np.ndarray, "T J"]
    """[rad/s or m/s]"""
    target_current: Float[np.ndarray, "T J"]
    """[A]"""
    force: Float[np.ndarray, "T 3"] | None = None
    """at the end of the arm, in the world, known in a simulation [N]"""
    remarks: tuple[str, ...] = ()
    """sentences on what was left out"""


FORCE = ("push_x", "push_y", "push_z")
"""columns of the true force"""


def columns_of(joints: Sequence[str]) -> tuple[str, ...]:
    """Names of the columns of an arm's recording, besides `time`."""
    return tuple(f"{joint}_{column}" for joint in joints for column in COLUMNS)


def read_arm(
    path: str | Path,
    joints: Sequence[str],
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
) -> ArmRecording:
    """The recording of an arm in a file: CSV with a header row, `.npz`, `.mat` or `.parquet`.

    Joints are in the robot's order; `columns` has the file's name for `time` or one of
    `columns_of`, where it differs. The sampling time must be dt [s], or so many times shorter: then
    rows are left out; without dt it is the file's own.

    Raises:
        RecordingError: the file cannot be read; the sentence names row and column.
        InputError: `columns` cannot be meant.
    """
    optional = [f"{joint}_velocity" for joint in joints]
    rows = read_rows(path, columns_of(joints), optional=optional, columns=columns or {})
    rows = _thinned(rows, dt)
    arrays = {column: rows.columns([f"{j}_{column}" for j in joints]) for column in COLUMNS}
    for joint, current in zip(joints, arrays["current"].T, strict=True):
        if not np.isfinite(current).any():
            raise RecordingError(
                f"{path}: expected the measured current of {joint}, got empty cells only; log the "
                "currents of all motors."
            )
    force = None
    if all(name in rows.table.columns for name in FORCE):
        columns_of_force = [rows.table.numbers(name)[rows.kept] for name in FORCE]
        force = np.nan_to_num(np.column_stack(columns_of_force))
    return ArmRecording(Path(path).stem, rows.time, force=force, remarks=rows.remarks, **arrays)


def _thinned(rows: LogRows, dt: float | None) -> LogRows:
    """Every so many of the rows, so that they are dt apart."""
    if dt is None:
        rows.require_seconds()
        return rows
    own = sampling_time(rows.time)
    step = max(round(dt / own), 1)
    if abs(step * own - dt) > 0.02 * dt:
        raise RecordingError(
            f"{rows.table.path}: expected samples every {dt:g} s, or so many times as often, got "
            f"{own:g} s; record at that rate, or learn a model at this one."
        )
    return rows[::step]


def arm_samples(log: ArmRecording, window: int = WINDOW) -> ArmSamples:
    """The samples of a recording at which all is known.

    Derivatives see the past only, as a detector does; the first samples after a gap have none and
    are left out.

    Raises:
        InputError: at half of the samples something is not known.
    """
    dt = sampling_time(log.time)
    parts = []
    breaks = np.flatnonzero(np.diff(log.time) > _LATE * dt) + 1
    absent = ~np.isfinite(log.velocity).any(axis=0)
    for rows in np.split(np.arange(len(log.time)), breaks):
        q = log.position[rows]
        dq = np.where(absent, slopes(q, dt, window), log.velocity[rows])
        eq, deq = log.target_position[rows] - q, log.target_velocity[rows] - dq
        ddq, ic = slopes(dq, dt, window), log.target_current[rows]
        parts.append(ArmSamples(log.time[rows], q, dq, ddq, eq, deq, ic, log.current[rows]))
    whole = ArmSamples.joined(parts)
    known = np.isfinite(np.hstack([whole.augmented, whole.i])).all(axis=1)
    if known.mean() < _KNOWN:
        raise InputError(
            f"expected samples at which positions, currents and targets of all joints are known, "
            f"got {known.sum()} of {len(known)}, the others hold NaN or empty cells; log all "
            "joints at the same instants."
        )
    return whole[known]
