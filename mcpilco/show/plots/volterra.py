"""Plots of Volterra series: their maps, what their priors penalise, and what they predict."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from mcpilco.show.plots.style import MODEL, PARTICLES, SYSTEM, add_legend, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_INTERVAL = 1.96
"""95 % of a normal distribution lie within so many standard deviations"""


def plot_lags(values: Float[np.ndarray, "D D"], title: str = "", ax: Axes | None = None) -> Axes:
    """Magnitudes over two lags, the largest black, as figure 6.2 of the thesis has them.

    Args:
        values: a map h_2, or its penalties lambda_h; only magnitudes relative to the largest are
            seen.
        title: above the picture.
        ax: where to draw; a new figure without it.
    """
    ax = new_axes()[0] if ax is None else ax
    size = np.abs(values)
    ax.imshow(size / max(float(size.max()), 1e-300), cmap="Greys", vmin=0.0, vmax=1.0)
    ax.set(xlabel="lag [samples]", ylabel="lag [samples]", title=title)
    return ax


def plot_response(
    h: Float[np.ndarray, " D"], dt: float | None = None, ax: Axes | None = None
) -> Axes:
    """The linear map h_1 over its lags.

    Args:
        h: of one input and output.
        dt: sampling time [s]; None: the axis counts samples.
        ax: where to draw; a new figure without it.
    """
    ax = new_axes()[0] if ax is None else ax
    ax.plot((dt or 1.0) * np.arange(len(h)), h, ".-", color=MODEL)
    ax.axhline(0.0, color=PARTICLES, linewidth=0.5)
    ax.set(xlabel="lag [s]" if dt else "lag [samples]", ylabel="h_1 [output/input]")
    return ax


def plot_prediction(
    measured: Float[np.ndarray, " T"],
    mean: Float[np.ndarray, " T"],
    std: Float[np.ndarray, " T"],
    name: str,
    ax: Axes | None = None,
) -> Axes:
    """What was measured, and what a model says of it with its 95 % interval.

    Args:
        measured: outputs.
        mean: predicted; NaN where it is not.
        std: of the prediction, the measurement's noise included.
        name: of the output, with its unit.
        ax: where to draw; a new figure without it.
    """
    ax = new_axes()[0] if ax is None else ax
    k = np.arange(len(mean))
    low, high = mean - _INTERVAL * std, mean + _INTERVAL * std
    ax.fill_between(k, low, high, color=PARTICLES, alpha=0.4, linewidth=0, label="95 %")
    ax.plot(k, measured, color=SYSTEM, linewidth=0.8, label="measured")
    ax.plot(k, mean, color=MODEL, linewidth=1.0, label="predicted")
    ax.set(xlabel="time [samples]", ylabel=name)
    add_legend(ax)
    return ax
