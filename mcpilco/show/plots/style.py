"""Style of all plots: colours, new axes, the band of the particles, shades by trial."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Float

from mcpilco.files import write_bytes
from mcpilco.gp import evenly_spaced
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
    dt: float,
    particles: Float[np.ndarray, "T P"],
    middle: Callable[..., np.ndarray],
    first: int = 0,
    held: bool = False,
) -> None:
    """The band of the particles, some of them as lines, and a line in their middle.

    They are of the steps `first`, first + 1, ..., of dt [s]; `held` values last until the next
    one. The `middle` is their `np.median` or `np.mean`.
    """
    times = dt * np.arange(first, first + len(particles))
    low, high = np.percentile(particles, QUANTILES, axis=1)
    label = f"particles, {QUANTILES[0]} to {QUANTILES[1]} %"
    step: Literal["post"] | None = "post" if held else None
    style = "steps-post" if held else "default"
    ax.fill_between(
        times, low, high, color=PARTICLES, alpha=0.3, linewidth=0, label=label, step=step
    )
    shown = particles[:, evenly_spaced(particles.shape[1], _LINES)]
    # As pixels, for many lines would make a vector picture heavy.
    ax.plot(
        times, shown, color=PARTICLES, alpha=0.5, linewidth=0.4, drawstyle=style, rasterized=True
    )
    line = middle(particles, axis=1)
    ax.plot(times, line, color=MODEL, label=middle.__name__, drawstyle=style)


def trial_shades(count: int) -> list[Any]:
    """A blue for each trial, the later the darker."""
    from matplotlib import colormaps

    return [colormaps["Blues"](shade) for shade in np.linspace(_LIGHTEST, 1.0, count)]


def add_legend(ax: Axes) -> None:
    """A legend without a frame, small; none where nothing has a name."""
    if ax.get_legend_handles_labels()[0]:
        ax.legend(frameon=False, fontsize="small")


def plain_ticks(axis: Axis, subs: Sequence[float] | None = None) -> None:
    """Numbers instead of powers along a logarithmic axis; a page does not set formulas.

    They stand at these parts of a decade, by default as many as there is room for.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = axis.get_view_interval()
    subs = subs or ((1.0, 2.0, 5.0) if high < 30 * low else (1.0,))

    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())
