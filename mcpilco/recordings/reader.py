"""The one reader of log files: columns by name, rows in the order of time, remarks on the rest.

`read_rows` reads what every kind of recording begins with; `read_recording` makes states and inputs
on a uniform grid of it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from mcpilco.recordings.recording import Gaps, Recording, Samples
from mcpilco.recordings.resample import (
    AVERAGED,
    Log,
    find_gaps,
    increasing,
    on_grid,
    readings,
    resampled,
    sampling_time,
    with_lost_rows,
)
from mcpilco.recordings.suspicion import (
    Partner,
    about_clock,
    about_gaps,
    about_lost_rows,
    about_resampling,
    quantisation_step,
    spikes,
    suspicions,
    unwrapped,
)
from mcpilco.recordings.table import Table, read_table
from mcpilco.typing import InputError, RecordingError

FEWEST = 10
"""rows that a recording must have"""
_DISORDER = 0.05  # share of rows whose stamps may be out of order
_LONGEST_STEP_S = 1.0  # median; a longer one is milliseconds, unless dt is given
_SPARSE = 20  # samples of the grid a row, beyond which the stamps are wrong
_PAUSE = 10_000  # samples that a pause of the log may take besides

Pairs = Sequence[tuple[int, int]]


# rows of any log ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class LogRows(Samples):
    """Rows of a log file in the order of their time stamps: what all recordings are read from."""

    table: Table
    """the file"""
    sources: Mapping[str, str]
    """the file's name for `time` and each other column that it has"""
    kept: Int[np.ndarray, " N"]
    """places of the rows in the table"""
    stamps: Float[np.ndarray, " N"]
    """their time stamps, increasing [s]"""
    remarks: tuple[str, ...]
    """sentences on rows that were left out"""

    @property
    def time(self) -> Float[np.ndarray, " N"]:
        """From 0 [s]."""
        return self.stamps - self.stamps[0]

    def columns(self, names: Sequence[str]) -> Float[np.ndarray, "N U"]:
        """Some columns side by side, NaN where one is absent."""
        absent, of = np.full(len(self.kept), np.nan), self.sources
        found = [self.table.numbers(of[n])[self.kept] if n in of else absent for n in names]
        return np.column_stack(found) if found else np.empty((len(self.kept), 0))

    def row(self, k: int) -> int:
        """Place of the k-th row in the file, as its messages count."""
        return int(self.table.rows[self.kept[k]])

    def require_seconds(self) -> None:
        """Raises RecordingError where the time stamps are no seconds, by their step."""
        step = float(np.median(np.diff(self.time)))
        if step >= _LONGEST_STEP_S:
            raise RecordingError(
                f"{self.table.path}, column {self.sources['time']!r}: expected seconds, got a "
                f"median step of {step:g}, which looks like milliseconds or less; say which, for "
                f"example --columns time={self.sources['time']}@ms, or give dt."
            )


def read_rows(
    path: str | Path,
    names: Sequence[str] | None = None,
    *,
    optional: Collection[str] = (),
    columns: Mapping[str, str] | None = None,
) -> LogRows:
    """The rows of a log file, ordered by its column `time`, with some of its columns.

    Rows without a time stamp, and those whose stamps repeat or run backwards, are left out with a
    remark; where they are many, the file is refused.

    Args:
        path: of a CSV with a header row, an `.npz`, `.mat` or `.parquet`.
        names: of the columns besides `time`; all that the file has by default.
        optional: which of them may be absent; `time` too: then rows count as seconds.
        columns: the file's name for `time` or another column, where it differs, with its unit
            where that is not the SI's (`q1@deg`), empty for one that is ignored; None where names
            cannot be mapped.

    Raises:
        RecordingError: the file cannot be read; the sentence names row and column.
        InputError: `columns` cannot be meant.
    """
    table = read_table(path)
    if names is None:
        names = [name for name in table.columns if name != "time"]
    sources = _sources(table, ("time", *names), optional, columns)
    if "time" not in sources:
        every = np.arange(len(table.rows))
        return LogRows(table, sources, every, every.astype(float), table.remarks)
    kept, stamps, remarks = _in_order(table, sources["time"])
    plain = [source for source in sources.values() if source in table.columns]
    by_name = [source for source in plain if table.source(source)[1] != 1.0]
    converted = [f"{source!r} is converted to SI units, as its name says." for source in by_name]
    return LogRows(table, sources, kept, stamps, (*table.remarks, *converted, *remarks))


def _sources(
    table: Table, names: Sequence[str], optional: Collection[str], mapped: Mapping[str, str] | None
) -> dict[str, str]:
    """The file's name for each column; one that is optional and absent is left out."""
    columns = mapped or {}
    unknown = sorted(set(columns) - set(names))
    if unknown:
        raise InputError(
            f"A column map expected names of the plant ({_cut(', '.join(names))}) before the "
            f"equals sign, got {', '.join(unknown)}; write NAME_OF_THE_PLANT=NAME_IN_THE_FILE."
        )
    needed = sorted(name for name in columns if not columns[name] and name not in optional)
    if needed:
        raise InputError(
            f"A column map expected the names of {', '.join(needed)}, which no recording can do "
            "without, got nothing after the equals sign; only velocities can be ignored."
        )
    sources = {
        name: table.written(columns.get(name) or _as_in_ros(table, name))
        for name in names
        if columns.get(name) != ""
    }
    missing = [
        name
        for name, source in sources.items()
        if not _has(table, source) and (name not in optional or name in columns)
    ]
    if missing:
        wanted = ", ".join(sources[name] for name in missing)
        present = _cut(", ".join(table.columns) or "none")
        remedy = f"say which they are, for example --columns {missing[0]}=NAME"
        raise RecordingError(
            f"{table.path}: expected a column for each of {wanted}, got the columns {present}; "
            f"{'rename them' if mapped is None else remedy}."
        )
    return {name: source for name, source in sources.items() if _has(table, source)}


def _as_in_ros(table: Table, name: str) -> str:
    """The column of a name that is not mapped: ROS calls `<joint>_torque` `<joint>_effort`."""
    effort = re.sub("_torque$", "_effort", name)
    return effort if name not in table.columns and effort in table.columns else name


def _has(table: Table, source: str) -> bool:
    return table.source(source)[0] in table.columns


def _cut(text: str) -> str:
    return text if len(text) <= 400 else f"{text[:400]}..."


def _in_order(
    table: Table, column: str
) -> tuple[Int[np.ndarray, " N"], Float[np.ndarray, " N"], list[str]]:
    """The rows that are in the order of time, their stamps [s], and remarks on the others."""
    stamps = table.stamps(column)
    known = np.flatnonzero(np.isfinite(stamps))
    _require_rows(table, len(known))
    kept = known[increasing(stamps[known])]
    remarks = list(_about_order(table, column, stamps, known, kept))
    _require_rows(table, len(kept))
    if not np.all(np.diff(stamps[kept] - stamps[kept[0]]) > 0):  # the difference was rounded
        raise table.error(column, kept[0], "a stamp near the others", f"{stamps[kept[0]]:g}")
    return kept, stamps[kept], remarks


def _about_order(
    table: Table, column: str, stamps: np.ndarray, known: np.ndarray, kept: np.ndarray
) -> Iterator[str]:
    """Remarks on the rows without a stamp (not `known`) and out of order (not `kept`)."""
    if len(known) < len(stamps):
        row = table.rows[np.flatnonzero(~np.isfinite(stamps))[0]]
        count = _count(len(stamps) - len(known), "row")
        yield f"{count} without a time stamp left out, the first of them row {row}."
    lost = np.setdiff1d(known, kept)
    if len(lost) > max(1, _DISORDER * len(known)):
        got = f"{stamps[lost[0]]:g} s and {len(lost)} rows like it, that repeat or run backwards"
        raise table.error(column, lost[0], "time to increase from row to row", got)
    if len(lost):
        yield (
            f"{_count(len(lost), 'row')} left out, whose time stamps repeat or run backwards, "
            f"the first of them row {table.rows[lost[0]]}."
        )


def _require_rows(table: Table, count: int) -> None:
    if count < FEWEST:
        raise RecordingError(
            f"{table.path}: expected at least {FEWEST} rows with a time stamp of their own, got "
            f"{count}; record for longer."
        )


# states and inputs on a grid ----------------------------------------------------------------------


def read_recordings(
    paths: Iterable[str | Path],
    state_names: Sequence[str],
    input_names: Sequence[str],
    **options: Any,
) -> tuple[list[Recording], list[RecordingError]]:
    """The recordings that can be read, and a sentence on each that cannot.

    The arguments are those of `read_recording`.
    """
    good, bad = [], []
    for path in paths:
        try:
            good.append(read_recording(path, state_names, input_names, **options))
        except RecordingError as error:
            bad.append(error)
    return good, bad


def read_recording(
    path: str | Path,
    state_names: Sequence[str],
    input_names: Sequence[str],
    *,
    angles: Sequence[int] = (),
    velocities: Pairs = (),
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
) -> Recording:
    """The recording in a file: CSV with a header row, `.npz`, `.mat` or `.parquet`.

    Args:
        path: of the file.
        state_names: of the plant; each needs a column, but for velocities.
        input_names: of the plant; each needs a column.
        angles: which states are angles [rad]; where the log has them wrapped, turns are counted.
        velocities: pairs (position, velocity) of states; the columns of velocities may be absent.
        columns: the file's name for `time`, a state or an input, where it differs, with its unit
            where that is not the SI's (`q1@deg`); empty for a velocity that is ignored.
        dt: step of the grid [s]; the log's own, rounded, when None.

    Raises:
        RecordingError: the file cannot be read; the sentence names row and column.
        InputError: `columns` or `dt` cannot be meant.
    """
    if dt is not None and not (math.isfinite(dt) and dt > 0):
        raise InputError(f"dt must be positive [s], got {dt}.")
    optional = {state_names[velocity] for _, velocity in velocities}
    rows = read_rows(path, (*state_names, *input_names), optional=optional, columns=columns or {})
    if dt is None:
        rows.require_seconds()
    log = Log(rows.time, rows.columns(state_names), rows.columns(input_names))
    _require_inputs(rows.table, log, input_names)
    remarks = [*rows.remarks, *_clean(log, state_names, angles, velocities)]
    own = sampling_time(log.time)
    step = own if dt is None else dt
    _require_grid(rows, log, step)
    log, lost = with_lost_rows(log, own)
    remarks += about_lost_rows(lost)
    still = set(range(len(state_names))) - {velocity for _, velocity in velocities}
    made = partial(
        Recording,
        name=Path(path).stem,
        state_names=tuple(state_names),
        input_names=tuple(input_names),
        angles=tuple(angles),
        velocities=tuple((q, v) for q, v in velocities),
        resolution=tuple(quantisation_step(column) for column in log.states.T),
    )
    recorded = partial(_recorded, made=made, positions=tuple(sorted(still)))
    read: tuple[Log, ...] = (log,)
    if step < AVERAGED * own and not on_grid(log.time, own):
        read = readings(log, own, partial(recorded, dt=own))
        remarks += about_clock(read, own)
    log = read[0]
    if not on_grid(log.time, step):
        remarks.append(about_resampling(log, step))
    recording = recorded(log, dt=step)
    if len(read) > 1:
        clocked = recorded(read[1], dt=step)
        every = max(recording.every, clocked.every)
        held = recording.driven(every) if every > 1 else None
        recording = replace(recording, held=held, by_clock=clocked.driven(every))
    _require_positions(rows.table, recording, sorted(still))
    remarks += [*about_gaps(recording.gaps), *suspicions(recording)]
    return replace(recording, remarks=tuple(remarks))


def _recorded(
    log: Log, made: Callable[..., Recording], positions: tuple[int, ...], dt: float
) -> Recording:
    """A log on a grid, `made` with all else; positions are states that are no velocities."""
    states, inputs, held = resampled(log, dt)
    gaps = find_gaps(log, states, positions, dt)
    _hold(inputs, gaps, dt)
    if held is not None:
        _hold(held, gaps, dt * len(inputs) / len(held))
    for start, end in gaps:
        states[round(start / dt) + 1 : round(end / dt)] = np.nan
    time = dt * np.arange(len(states))
    return made(time=time, states=states, inputs=inputs, held=held, gaps=gaps)


def _require_inputs(table: Table, log: Log, names: Sequence[str]) -> None:
    for name, column in zip(names, log.inputs.T, strict=True):
        if not np.isfinite(column).any():
            raise RecordingError(
                f"{table.path}: expected commands in the column of {name!r}, got empty cells only; "
                "fill it, with 0 where no command was given."
            )


def _require_positions(table: Table, recording: Recording, positions: Iterable[int]) -> None:
    for place in positions:
        name = recording.state_names[place]
        found = int(np.isfinite(recording.states[:, place]).sum())
        if found < FEWEST:
            raise RecordingError(
                f"{table.path}: expected at least {FEWEST} samples of {name!r} outside of gaps, "
                f"got {found}; fill the column, or record for longer."
            )


def _require_grid(rows: LogRows, log: Log, dt: float) -> None:
    """Raises where the step does not suit the stamps."""
    steps = np.diff(log.time)
    if dt < log.step / 2:
        raise InputError(
            f"dt must be at least half of the log's median step of {log.step:g} s, got {dt:g} s; "
            "leave it out to keep the log's own."
        )
    count = log.time[-1] / dt
    if count > _SPARSE * len(log.time) + _PAUSE:
        worst = int(steps.argmax())
        raise RecordingError(
            f"{rows.table.path}, row {rows.row(worst + 1)}: expected time stamps about "
            f"{log.step:g} s apart, got a jump of {steps[worst]:g} s; correct the stamp, or split "
            "the file there."
        )
    if count + 1 < FEWEST:
        raise RecordingError(
            f"{rows.table.path}: expected at least {FEWEST} samples at a step of {dt:g} s, got "
            f"{count + 1:.0f}; record for longer, or give a smaller dt."
        )


# what is wrong, masked and said -------------------------------------------------------------------


def _clean(
    log: Log, names: Sequence[str], angles: Sequence[int], velocities: Pairs
) -> Iterator[str]:
    """Mask spikes and unwrap angles, in place; yields remarks."""
    partners = {v: Partner(log.time, log.states[:, q], True) for q, v in velocities}
    partners |= {q: Partner(log.time, log.states[:, v], False) for q, v in velocities}
    for place, (name, column) in enumerate(zip(names, log.states.T, strict=True)):
        if place in angles:
            turning = unwrapped(column)
            if turning is not column:
                column[:] = turning
                yield f"{name} was wrapped to one turn; its turns are counted."
        missing = int(np.isnan(column).sum())
        if 0 < missing < len(column):
            yield f"{_count(missing, 'value')} of {name} missing, masked."
        breaks = np.flatnonzero(np.diff(log.time) > log.jump(0.0)) + 1
        spiky = np.zeros(len(column), dtype=bool)
        for rows in np.split(np.arange(len(column)), breaks):
            beside = partners[place][rows] if place in partners else None
            spiky[rows] = spikes(column[rows], beside)
        if spiky.any():
            first = log.time[spiky.argmax()]
            column[spiky] = np.nan
            yield (
                f"{_count(int(spiky.sum()), 'value')} of {name} far off their neighbours, masked, "
                f"the first of them at {first:.3f} s."
            )


def _hold(inputs: Float[np.ndarray, "T U"], gaps: Gaps, dt: float) -> None:
    """Hold the last input before each gap, in place."""
    for start, end in gaps:
        first, last = round(start / dt), round(end / dt)
        inputs[first:last] = inputs[first - 1] if first else inputs[last]


def _count(number: int, what: str) -> str:
    return f"1 {what}" if number == 1 else f"{number} {what}s"
