"""What `mcpilco collisions` says and writes of what it found."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from mcpilco.identification.collision import CurrentModel, Detections, Event, Thresholds
    from mcpilco.recordings import ArmSamples


def tell_errors(model: CurrentModel, held: ArmSamples) -> None:
    """Root mean square errors of each joint, in motion and at rest."""
    import numpy as np

    residual, still = held.i - model.mean(held), model.quiet(held)
    for name, rows in (("in motion", ~still), ("at rest", still)):
        count = np.maximum(rows.sum(axis=0), 1)
        error = np.sqrt((residual**2 * rows).sum(axis=0) / count)
        shown = ", ".join(f"{j} {e:.3g}" for j, e in zip(model.joints, error, strict=True))
        print(f"Error {name} [A]: {shown}")


def tell_limits(model: CurrentModel, limits: Thresholds) -> None:
    """The thresholds of each joint."""
    unit = "A" if limits.config.rule == "current" else "std"
    kinds = {"in motion": limits.moving, "at rest": limits.resting}
    for name, values in kinds.items() if limits.config.by_phase else (("", limits.moving),):
        shown = ", ".join(f"{j} {v:.3g}" for j, v in zip(model.joints, values, strict=True))
        print(f"Thresholds {f'{name} ' if name else ''}[{unit}]: {shown}")


def tell_alarms(name: str, alarms: Sequence[Event]) -> None:
    """A line an alarm."""
    print(f"{name}: {len(alarms)} alarms")
    for event in alarms:
        where = "at rest" if event.resting else "in motion"
        print(
            f"  {event.start_s:8.3f} s to {event.end_s:8.3f} s, {where}: "
            f"{', '.join(event.joints)}, {event.excess:.1f} thresholds"
        )


def tell_pushes(found: Detections, push: np.ndarray) -> None:
    """Which of the true pushes were found, and when."""
    import numpy as np

    from mcpilco.recordings import runs

    spans = runs(np.abs(push).max(axis=1) > 0.0)
    hits = 0
    for start, end in spans:
        at = np.flatnonzero(found.collision[start:end])
        force = float(np.linalg.norm(push[start:end], axis=1).max())
        told = "missed"
        if len(at):
            told = f"found after {1000 * (found.time[start + at[0]] - found.time[start]):.0f} ms"
        hits += bool(len(at))
        print(f"  push at {found.time[start]:.3f} s, {force:.0f} N: {told}")
    print(f"  {hits} of {len(spans)} pushes found")


def table(found: Detections, joints: Sequence[str]) -> bytes:
    """What a detector said, a row a sample."""
    import numpy as np

    kinds = ("expected", "residual", "threshold", "joints")
    names = ["time", *(f"{j}_{k if k != 'joints' else 'alarm'}" for k in kinds for j in joints)]
    arrays = np.hstack([getattr(found, kind).astype(float) for kind in kinds])
    return csv_bytes(names, np.round(np.column_stack([found.time, arrays]), 6).tolist())


def csv_bytes(names: Sequence[str], rows: Sequence[Sequence[float]]) -> bytes:
    """A table with a header row, as the content of a file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    return text.getvalue().encode()
