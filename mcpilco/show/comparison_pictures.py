"""A comparison as PNG files."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mcpilco.files import write_bytes
from mcpilco.show.plots.comparison import Curve, plot_curves, plot_seeds
from mcpilco.show.plots.style import add_legend
from mcpilco.sweep import Measure, Row, Run, common_amounts, measures
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_INCHES = (4.4, 2.8)
_DPI = 120


def write_curves(path: Path, runs: Sequence[Run], rows: Sequence[Row]) -> Path:
    """Learning curves, a panel a measure, with the intervals over seeds as bands.

    Args:
        path: of the picture.
        runs: in the order of their colours.
        rows: of `estimates`.

    Raises:
        InputError: matplotlib is missing.
        RunFolderError: the file cannot be written.
    """
    panels = []
    for measure in measures(runs):
        curves = {
            place: curve
            for place, run in enumerate(runs)
            if (curve := _curve(run.name, measure, rows)) is not None
        }
        if curves:
            label = measure.title if measure.statistics[0] == "mean" else f"{measure.title}, IQM"
            panels.append(lambda ax, c=curves, label=label: plot_curves(c, label, ax))
    return _write(path, panels, legend=True)


def write_seeds(path: Path, runs: Sequence[Run]) -> Path:
    """How the seeds are spread after most experience, a panel a measure.

    Raises:
        InputError: matplotlib is missing.
        RunFolderError: the file cannot be written.
    """
    common = common_amounts(runs)
    panels = []
    for measure in (measure for measure in measures(runs) if not measure.share):
        reached = {}
        for place, run in enumerate(runs):
            amount = common[-1] if common else float(run.amounts[-1])
            values = [measure.scale * v for v in run.at(amount, measure.key).values()]
            if values:
                reached[place] = f"{run.name}, {amount:g} s", values
        if reached:
            panels.append(lambda ax, r=reached, m=measure: plot_seeds(r, m.title, ax))
    return _write(path, panels)


def _curve(name: str, measure: Measure, rows: Sequence[Row]) -> Curve | None:
    mine = [
        row
        for row in rows
        if (row.run, row.measure, row.statistic) == (name, measure, measure.statistics[0])
    ]
    if not mine:
        return None
    found = [row.estimate for row in mine]
    experience = [row.experience_s for row in mine]
    columns = (experience, *([getattr(e, n) for e in found] for n in ("value", "low", "high")))
    return Curve(name, *(np.array(column, dtype=float) for column in columns))


def _write(path: Path, panels: Sequence[Callable[[Axes], object]], legend: bool = False) -> Path:
    """A picture of panels in two columns, the first with a legend."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise InputError(
            "Plots need matplotlib; install it with: pip install 'mcpilco[report]'"
        ) from error
    rows = -(-len(panels) // 2)
    size = 2 * _INCHES[0], rows * _INCHES[1]
    figure = Figure(figsize=size, layout="constrained")
    axes = list(figure.subplots(rows, 2, squeeze=False).flat)
    for ax, panel in zip(axes, panels, strict=False):
        panel(ax)
    if legend:
        add_legend(axes[0])
    for ax in axes[len(panels) :]:
        ax.remove()
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=_DPI)
    return write_bytes(path, content.getvalue())
