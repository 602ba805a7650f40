"""Style of all plots: colours, new axes, the band of the particles, shades by trial."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from mcpilco.files import write_bytes
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis

SYSTEM, MODEL, PARTICLES = "black", "tab:blue", "0.55"
Line = Float[np.ndarray, " T"]
"""a number at each of T instants"""
QUANTILES = (5, 95)
"""between which the band lies [%]"""
_LINES = 30
"""particles drawn as lines"""
_DPI = 110
_PANEL_INCHES = (4.2, 2.6)
_LIGHTEST = 0.35
"""shade of the first trial's line; the last one's is 1 [-]"""


def new_axes(count: int = 1) -> list[Axes]:
    """So many axes of a new figure, in two columns.

    Raises:
        InputError: matplotlib is missing.
    """
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise InputError(
            "Plots need matplotlib; install it with: pip install 'mcpilco[report]'"
        ) from error
    columns = min(count, 2)
    rows = -(-count // columns)
    width, height = _PANEL_INCHES
    figure, axes = plt.subplots(
        rows, columns, figsize=(width * columns, height * rows), squeeze=False, layout="constrained"
    )
    for spare in axes.flat[count:]:
        figure.delaxes(spare)
    return list(axes.flat[:count])


def write_picture(path: Path, ax: Axes) -> Path:
    """Write the figure of some axes as a PNG, and forget it; returns the file's path.

    Raises:
        RunFolderError: the file cannot be written.
    """
    import matplotlib.pyplot as plt

    figure, content = ax.get_figure(root=True), io.BytesIO()
    assert figure is not None, "axes of new_axes have one"
    figure.savefig(content, format="png", dpi=_DPI)
    plt.close(figure)
    return write_bytes(path, content.getvalue())


def draw_particles(
    ax: Axes,
    times: Line,
    particles: Float[np.ndarray, "T P"],
    middle: Line,
    name: str,
    held: bool = False,
) -> None:
    """The band of the particles, some of them as lines, and a line in their middle.

    The `middle` is their median or mean, as `name` says; `held` values last until the next one.
    """
    low, high = np.percentile(particles, QUANTILES, axis=1)
    label = f"particles, {QUANTILES[0]} to {QUANTILES[1]} %"
    step: Literal["post"] | None = "post" if held else None
    style = "steps-post" if held else "default"
    ax.fill_between(
        times, low, high, color=PARTICLES, alpha=0.3, linewidth=0, label=label, step=step
    )
    count = particles.shape[1]
    shown = particles[:, np.linspace(0, count - 1, min(count, _LINES)).round().astype(int)]
    # As pixels, for many lines would make a vector picture heavy.
    ax.plot(
        times, shown, color=PARTICLES, alpha=0.5, linewidth=0.4, drawstyle=style, rasterized=True
    )
    ax.plot(times, middle, color=MODEL, label=name, drawstyle=style)


def trial_shades(count: int) -> list[Any]:
    """A blue for each trial, the later the darker."""
    from matplotlib import colormaps

    return [colormaps["Blues"](shade) for shade in np.linspace(_LIGHTEST, 1.0, count)]


def add_legend(ax: Axes) -> None:
    """A legend without a frame, small; none where nothing has a name."""
    if ax.get_legend_handles_labels()[0]:
        ax.legend(frameon=False, fontsize="small")


def plain_ticks(axis: Axis, subs: Sequence[float]) -> None:
    """Numbers instead of powers along a logarithmic axis; a page does not set formulas."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
