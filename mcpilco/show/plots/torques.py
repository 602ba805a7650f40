"""Plots of a robot's torques: measured, and as a model of its inverse dynamics has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from mcpilco.show.plots.style import MODEL, SYSTEM, add_legend, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_torque(
    measured: Float[np.ndarray, " N"],
    predicted: Float[np.ndarray, " N"],
    name: str,
    unit: str,
    std: Float[np.ndarray, " N"] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """A joint's torque over the samples, measured in black and predicted in blue.

    Args:
        measured: with its noise, in `unit`.
        predicted: by the model, from the motion alone.
        name: of the joint.
        unit: of the torque.
        std: of the prediction; draws a band of two of them.
        ax: where to draw; a new figure without it.
    """
    ax = new_axes()[0] if ax is None else ax
    n = np.arange(len(measured))
    ax.plot(n, measured, color=SYSTEM, linewidth=2.5, alpha=0.4, label="measured")
    ax.plot(n, predicted, color=MODEL, linewidth=1.0, label="model")
    if std is not None:
        low, high = predicted - 2 * std, predicted + 2 * std
        ax.fill_between(n, low, high, color=MODEL, alpha=0.25, linewidth=0)
    ax.set(xlabel="held-out sample", ylabel=f"{name} [{unit}]")
    add_legend(ax)
    return ax
