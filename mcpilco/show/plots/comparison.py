"""Plots of several runs beside one another: learning curves, and how the seeds are spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from mcpilco.show.plots.style import SYSTEM, new_axes, plain_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = ("blue", "orange", "green", "purple", "red", "brown", "cyan", "olive")
"""of matplotlib's table `tab:`"""
_FEW = 6
"""at most so many amounts of experience are named below the axis"""
_DECADES = 1.5
"""amounts of experience that span more powers of ten stand on a logarithmic axis"""


@dataclass(frozen=True)
class Curve:
    """A statistic over seeds, after each amount of experience."""

    name: str
    experience_s: Float[np.ndarray, " T"]
    values: Float[np.ndarray, " T"]
    low: Float[np.ndarray, " T"]
    """lower end of the band; NaN where there is none"""
    high: Float[np.ndarray, " T"]


def run_colour(place: int) -> str:
    """The colour of a run, by its place among all."""
    return f"tab:{_COLOURS[place % len(_COLOURS)]}"


def plot_curves(curves: Mapping[int, Curve], label: str, ax: Axes | None = None) -> Axes:
    """A line a run over experience, with the interval as a band; without a legend.

    Reference: thesis figure 5.2, whose bands are standard deviations.
    """
    ax = new_axes()[0] if ax is None else ax
    for place, curve in curves.items():
        colour = run_colour(place)
        ax.fill_between(
            curve.experience_s, curve.low, curve.high, color=colour, alpha=0.2, linewidth=0
        )
        ax.plot(curve.experience_s, curve.values, ".-", color=colour, label=curve.name)
    amounts = np.concatenate([curve.experience_s for curve in curves.values()])
    ax.set(xlabel="experience [s]", ylabel=label)
    if amounts.min() > 0 and np.log10(amounts.max() / amounts.min()) > _DECADES:
        plain_log_axis(ax)
    elif len(known := np.unique(amounts)) <= _FEW:
        ax.set_xticks(known)
    return ax


def plain_log_axis(ax: Axes) -> None:
    """A logarithmic axis of x with ordinary numbers at 1, 3, 10, 30 and so on."""
    ax.set_xscale("log")
    plain_ticks(ax.xaxis, (1.0, 3.0))


def plot_seeds(
    values: Mapping[int, tuple[str, Sequence[float]]], label: str, ax: Axes | None = None
) -> Axes:
    """A point a seed in a line a run, above a box of their quartiles and a bar at their median."""
    ax = new_axes()[0] if ax is None else ax
    rng = np.random.default_rng(0)  # points that are equal lie beside one another
    for line, (place, (_, seeds)) in enumerate(values.items()):
        ax.boxplot(
            [seeds],
            orientation="horizontal",
            positions=[line],
            widths=0.6,
            showfliers=False,
            medianprops={"color": SYSTEM},
        )
        heights = line + rng.uniform(-0.2, 0.2, len(seeds))
        ax.plot(seeds, heights, ".", color=run_colour(place), alpha=0.6, markersize=5)
    names = [name for name, _ in values.values()]
    ax.set(xlabel=label, yticks=range(len(names)), yticklabels=names)
    ax.invert_yaxis()
    return ax
