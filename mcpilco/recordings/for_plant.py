"""Recordings of a plant: columns named as its states and inputs, all at one sampling time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

from mcpilco.recordings.reader import read_recordings
from mcpilco.recordings.recording import Gaps, Recording
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.plant import Plant


def read_for_plant(
    plant: Plant,
    paths: Sequence[Path],
    columns: Mapping[str, Mapping[str, str]] | None = None,
    dt: float | None = None,
    events: Mapping[str, Gaps] | None = None,
) -> tuple[list[Recording], list[str]]:
    """The recordings that can be read, and a sentence on what is noteworthy about each.

    `columns` are the names of time, states and inputs in files, where they differ, by a file's
    name, stem or pattern; `*` is of all, and one that comes later goes before. All are brought to
    the sampling time dt [s], by default the longest of theirs. `events` are spans of time [s] by a
    recording's name, such as contacts, that nothing is compared in.

    Raises:
        InputError: none of the files can be read, or one with columns is not among them.
    """
    maps = columns or {}
    strange = [file for file in maps if file != "*" and not any(_is(path, file) for path in paths)]
    if strange:
        raise InputError(
            f"--columns FILE:NAME=COLUMN expected one of {', '.join(path.name for path in paths)}, "
            f"got {', '.join(strange)}; name a recording, or a pattern such as swing*."
        )
    states = plant.layout.states
    velocities = tuple((k, k + 1) for k in range(0, len(states), 2))

    def read_all(chosen: Sequence[Path], step: float | None) -> list[Recording]:
        good, bad = [], []
        for path in chosen:
            own = [maps[file] for file in maps if _is(path, file)]
            read, left_out = read_recordings(
                [path],
                states,
                plant.layout.inputs,
                angles=plant.angles,
                velocities=velocities,
                columns={name: column for each in own for name, column in each.items()},
                dt=step,
            )
            good += read
            bad += left_out
        notes.extend(f"left out: {error}" for error in bad)
        if not good:
            faults = " ".join(str(error) for error in bad)
            raise InputError(f"none of the recordings can be read: {faults}")
        return good

    notes: list[str] = []
    good = read_all(paths, dt)
    steps = sorted({round(recording.dt, 9) for recording in good})
    if len(steps) > 1:
        names = {recording.name for recording in good}
        good = read_all([path for path in paths if path.stem in names], steps[-1])
        told = ", ".join(f"{step:g}" for step in steps)
        notes.append(
            f"sampling times are {told} s: all are read at {steps[-1]:g} s (--dt names another)."
        )
    notes += [f"{one.name}: {' '.join(one.remarks)}" for one in good if one.remarks]
    masked = {name: spans for name, spans in (events or {}).items() if spans}
    if masked and not masked.keys() & {path.stem for path in paths}:
        raise InputError(
            f"events are of {', '.join(masked)}, expected some of "
            f"{', '.join(path.stem for path in paths)}; name the recordings that they are of."
        )
    for one in good:
        if spans := masked.get(one.name):
            notes.append(f"{one.name}: {len(spans)} events are masked.")
    return [one.without(masked.get(one.name, ())) for one in good], notes


def _is(path: Path, pattern: str) -> bool:
    """Whether a pattern means a file, by its name with or without what is after the point."""
    return any(fnmatchcase(name, pattern) for name in (path.name, path.stem, str(path)))
