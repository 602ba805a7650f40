"""Recordings of a plant: columns named as its states and inputs, all at one sampling time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from mcpilco.recordings.reader import read_recordings
from mcpilco.recordings.recording import Recording
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.plant import Plant


def read_for_plant(
    plant: Plant,
    paths: Sequence[Path],
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
) -> tuple[list[Recording], list[str]]:
    """The recordings that can be read, and a sentence on what is noteworthy about each.

    Args:
        plant: whose states and inputs the columns are.
        paths: CSV, npz or parquet files.
        columns: the files' names of time, states and inputs, where they differ.
        dt: sampling time to which all are brought [s]; None: the longest of theirs.

    Raises:
        InputError: none of the files can be read.
    """
    states = plant.layout.states
    velocities = tuple((k, k + 1) for k in range(0, len(states), 2))

    def read(chosen: Sequence[Path], step: float | None) -> list[Recording]:
        good, bad = read_recordings(
            chosen,
            states,
            plant.layout.inputs,
            angles=plant.angles,
            velocities=velocities,
            columns=columns,
            dt=step,
        )
        notes.extend(f"left out: {error}" for error in bad)
        if not good:
            faults = " ".join(str(error) for error in bad)
            raise InputError(f"none of the recordings can be read: {faults}")
        return good

    notes: list[str] = []
    good = read(paths, dt)
    steps = sorted({round(recording.dt, 9) for recording in good})
    if len(steps) > 1:
        names = {recording.name for recording in good}
        good = read([path for path in paths if path.stem in names], steps[-1])
        told = ", ".join(f"{step:g}" for step in steps)
        notes.append(
            f"sampling times are {told} s: all are read at {steps[-1]:g} s (--dt names another)."
        )
    notes += [f"{one.name}: {remark}" for one in good for remark in one.remarks]
    return good, notes
