"""Held-out windows as a Rerun recording: measured, nominal and corrected plant side by side."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mcpilco.gap import Comparison, Gap, scaled_errors, squares_at_end, three_digits
from mcpilco.show.bodies import chain_scene
from mcpilco.show.side_by_side import Clip, Naming, write_side_by_side
from mcpilco.typing import InputError

CLIPS = 12
"""windows at most"""


def write_film(gap: Gap, path: Path) -> Path:
    """The path of the recording written; the window that is missed most comes first.

    Args:
        gap: of which it tells.
        path: where the .rrd file goes.

    Raises:
        InputError: the recordings were too poor to compare anything.
        RunFolderError: the file cannot be written.
    """
    if gap.comparison is None or gap.models is None:
        raise InputError("a film needs models that were compared; the recordings are too poor.")
    found, names = gap.comparison, gap.models.shown
    errors = {
        name: np.sqrt(np.nanmean(squares_at_end(scaled_errors(found.windows, y)), axis=1))
        for name, y in found.runs.items()
    }
    order = sorted(_apart(found), key=lambda w: -errors[names[0]][w])
    clips = [_clip(gap, found, w, names, errors) for w in order[:CLIPS]]
    chain = gap.plant.chain
    layout = gap.plant.layout
    naming = Naming(
        states=dict(zip(layout.states, layout.units, strict=True)),
        inputs=dict.fromkeys(layout.inputs, ""),
    )
    name = gap.plant.name
    return write_side_by_side(path, clips, found.windows.dt, naming, chain_scene(chain), name)


def _clip(
    gap: Gap, found: Comparison, w: int, names: tuple[str, ...], errors: dict[str, np.ndarray]
) -> Clip:
    """One window."""
    windows = found.windows
    start = float(windows.start_s[w])
    title = f"### {gap.held_out[windows.recording[w]]}, from {start:.1f} s"
    told = ", ".join(f"{name} **{three_digits(errors[name][w])}**" for name in names)
    colors = ", ".join(f"{c}: {n}" for c, n in zip(("Orange", "blue"), names, strict=False))
    words = f"White: measured. {colors}, in free runs."
    return Clip(
        note=f"{title}\n\nError at the end, in noise std: {told}\n\n{words}",
        measured=windows.y[w].T,
        inputs=windows.commands[w, windows.lead :],
        models={name: found.runs[name][w].T for name in names},
    )


def _apart(found: Comparison) -> list[int]:
    """Windows that do not overlap."""
    windows, chosen = found.windows, []
    length = windows.y.shape[2] * windows.dt
    end, last = -np.inf, -1
    for w, (n, start) in enumerate(zip(windows.recording, windows.start_s, strict=True)):
        if n != last or start >= end - 1e-9:
            chosen.append(w)
            end, last = start + length, n
    return chosen
