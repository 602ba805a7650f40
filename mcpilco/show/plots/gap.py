"""Plots of where a simulation and recordings disagree, and of what a correction is worth.

The measurement is black, the nominal plant orange, the corrected one blue, what noise alone does
grey.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from mcpilco.show.plots.style import MODEL, PARTICLES, SYSTEM, add_legend, new_axes, plain_ticks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NOMINAL, REFIT = "tab:orange", "tab:purple"
_STYLES: dict[str, dict[str, Any]] = {
    "nominal": {"color": NOMINAL, "label": "nominal"},
    "refit": {"color": REFIT, "linestyle": "--", "label": "refitted"},
    "corrected": {"color": MODEL, "label": "corrected"},
}
"""of a plant's line, by its name"""
_FLOOR = "noise_floor"
_BINS, _CELLS = 24, 20
"""of a profile; of a map along each axis"""
_WIDEST = 10.0
"""times the largest error that an interval is drawn to [-]"""
_FEWEST = 5
"""instants in a bin that is drawn"""
_BAR: dict[str, Any] = {"pad": 0.03, "fraction": 0.1, "aspect": 25}
"""where a scale of colours stands beside its map"""
_ABOVE: dict[str, Any] = {"fontsize": "small", "loc": "right", "pad": 3}
"""what a picture shows, above it"""
_EDGE = 0.5
"""what a picture leaves out at both ends of the values' range [%]"""
Channel = Float[np.ndarray, " N"]
"""a number an instant"""


def plot_growth(
    times: Float[np.ndarray, " T"],
    errors: Mapping[str, Float[np.ndarray, " T"]],
    bands: Mapping[str, Float[np.ndarray, "2 T"]],
    ax: Axes | None = None,
) -> Axes:
    """How the error of free runs grows with the time since their start, with 95 % intervals.

    Errors are in [noise std], of each plant by name, and of `noise_floor`.
    """
    ax = new_axes()[0] if ax is None else ax
    for name, values in errors.items():
        seen = np.isfinite(values)
        low, high = np.minimum(bands[name][:, seen], _WIDEST * np.nanmax(values))
        if name == _FLOOR:
            ax.fill_between(times[seen], 0.0, values[seen], color=PARTICLES, alpha=0.3, linewidth=0)
            ax.plot(times[seen], values[seen], color=PARTICLES, label="noise alone")
            continue
        style = _STYLES[name]
        ax.fill_between(times[seen], low, high, color=style["color"], alpha=0.2, linewidth=0)
        ax.plot(times[seen], values[seen], **style)
    least = min(float(np.nanmin(values)) for values in errors.values())
    ax.set(
        xlabel="time since the start [s]",
        ylabel="error [noise std]",
        yscale="log",
        ylim=(0.7 * least, None),
        xlim=(0, None),
    )
    plain_ticks(ax.yaxis)
    add_legend(ax)
    return ax


def plot_shrink(
    names: Sequence[str],
    errors: Float[np.ndarray, " S"],
    ends: Float[np.ndarray, "2 S"],
    floor: float,
    ax: Axes | None = None,
) -> Axes:
    """The error with one thing more mended at each step, with 95 % intervals.

    Errors are in [noise std]; the first of the steps is the nominal plant, and `floor` is what
    noise alone does.
    """
    ax = new_axes()[0] if ax is None else ax
    ends = np.minimum(ends, _WIDEST * float(errors.max()))
    places = np.arange(len(names))
    colors = [NOMINAL, *[PARTICLES] * (len(names) - 2), MODEL][: len(names)]
    reach = np.maximum(np.abs(ends - errors), 0.0)
    ax.barh(places, errors, 0.42, color=colors, alpha=0.85)
    ax.errorbar(errors, places, xerr=reach, fmt="none", ecolor=SYSTEM, capsize=2, linewidth=1)
    ax.axvline(floor, color=SYSTEM, linewidth=1, linestyle=":")
    least = 0.5 * min(floor, float(errors.min()))
    words: dict[str, Any] = {"fontsize": "small", "va": "center"}
    words["bbox"] = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}  # over the dotted line
    ax.text(1.04 * floor, -0.72, "noise alone", **words)
    for place, (name, error) in enumerate(zip(names, errors, strict=True)):
        text = name if place == 0 else f"+ {name}"
        number = f"{error:.0f}" if error >= 1000.0 else f"{error:.3g}"
        ax.text(1.06 * least, place - 0.35, f"{text}: {number}", **words)
    ax.set(
        xlabel="error at the end [noise std]",
        xscale="log",
        xlim=(least, 1.6 * max(float(ends.max()), 2 * floor)),
        ylim=(len(names) - 0.6, -1.0),
        yticks=[],
    )
    plain_ticks(ax.xaxis)
    return ax


def plot_time_map(
    edges: Float[np.ndarray, " C_plus_1"],
    names: Sequence[str],
    misfit: Float[np.ndarray, "R C"],
    label: str,
    events: Sequence[tuple[int, float, float]] = (),
    most: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """How far a plant misses one channel, a row for each recording, over its time.

    Cells end at `edges` [s]; the misfit of each recording in each cell is in [noise std], NaN where
    there is none; the label tells what is missed by whom. Events are spans that were left out:
    number of the recording, start and end [s]. `most` is the misfit at the end of the scale, to
    compare maps, by default the largest.
    """
    from matplotlib.colors import LogNorm

    ax = new_axes()[0] if ax is None else ax
    top = max(float(np.nanmax(misfit)) if most is None else most, 3.0)
    mesh = ax.pcolormesh(
        edges,
        np.arange(len(names) + 1) - 0.5,
        np.ma.masked_invalid(misfit),
        cmap="OrRd",
        norm=LogNorm(1.0, top),
        rasterized=True,
    )
    for row, start, end in events:
        ax.plot([start, end], [row, row], color=SYSTEM, linewidth=2, marker="|", markersize=7)
    ax.set(xlabel="time [s]", yticks=range(len(names)), ylim=(len(names) - 0.5, -0.5))
    short = [name if len(name) <= 14 else f"{name[:6]}…{name[-7:]}" for name in names]
    ax.set_yticklabels(short, fontsize="small")
    ax.set_title(f"{label} [noise std]", **_ABOVE)
    ax.set_facecolor("0.9")
    bar = ax.figure.colorbar(mesh, ax=ax, **_BAR)
    ticks = [tick for tick in (1, 3, 10, 30, 100, 300, 1000) if tick <= top]
    bar.set_ticks(ticks, labels=[str(tick) for tick in ticks], minor=False)
    bar.ax.minorticks_off()
    return ax


def plot_profile(
    profiles: Mapping[str, tuple[Channel, Channel]], labels: tuple[str, str], ax: Axes | None = None
) -> Axes:
    """The force that plants leave over along one quantity: medians, and where half of them lie."""
    ax = new_axes()[0] if ax is None else ax
    ax.axhline(0.0, color=PARTICLES, linewidth=1)
    for name, (along, force) in profiles.items():
        edges = np.linspace(*_range(along), _BINS + 1)
        places = np.digitize(along, edges) - 1
        bins = [b for b in range(_BINS) if (places == b).sum() >= _FEWEST]
        quartiles = np.array([np.percentile(force[places == b], [25, 50, 75]) for b in bins])
        middles, (low, median, high) = 0.5 * (edges[:-1] + edges[1:])[bins], quartiles.T
        style = _STYLES[name]
        ax.fill_between(middles, low, high, color=style["color"], alpha=0.2, linewidth=0)
        ax.plot(middles, median, marker=".", **style)
    ax.set(xlabel=labels[0], ylabel=labels[1])
    ax.locator_params(nbins=6)
    add_legend(ax)
    return ax


def plot_force_map(
    q: Channel, v: Channel, force: Channel, labels: tuple[str, str, str], ax: Axes | None = None
) -> Axes:
    """The force that a plant leaves over, as medians over position and velocity."""
    from matplotlib.ticker import MaxNLocator
    from scipy.stats import binned_statistic_2d

    ax = new_axes()[0] if ax is None else ax
    edges = [np.linspace(*_range(values), _CELLS + 1) for values in (q, v)]
    cells, counts = (
        binned_statistic_2d(q, v, force, kind, edges).statistic.T for kind in ("median", "count")
    )
    cells[counts < 2] = np.nan
    seen = np.abs(cells[np.isfinite(cells)])
    most = float(np.percentile(seen, 95)) if len(seen) else 1.0
    mesh = ax.pcolormesh(
        *edges, np.ma.masked_invalid(cells), cmap="RdBu_r", vmin=-most, vmax=most, rasterized=True
    )
    ax.set(xlabel=labels[0], ylabel=labels[1])
    ax.set_facecolor("0.9")
    ax.set_title(labels[2], **_ABOVE)
    ax.figure.colorbar(mesh, ax=ax, **_BAR).locator = MaxNLocator(5)
    return ax


def plot_window(
    times: Float[np.ndarray, " T"],
    measured: Float[np.ndarray, " T"],
    runs: Mapping[str, Float[np.ndarray, " T"]],
    label: str,
    title: str,
    known_s: float,
    ax: Axes | None = None,
) -> Axes:
    """One window of a recording, and the free runs of plants through it.

    Up to `known_s` the runs' starts were fitted [s].
    """
    ax = new_axes()[0] if ax is None else ax
    ax.axvspan(0.0, known_s, color=PARTICLES, alpha=0.15, linewidth=0)
    ax.plot(times, measured, ".", color=SYSTEM, markersize=3, label="measured")
    for name, values in runs.items():
        ax.plot(times, values, **_STYLES[name])
    ax.set(xlabel="time since the start [s]", ylabel=label, xlim=(0, times[-1]))
    ax.set_title(title, **_ABOVE)
    add_legend(ax)
    return ax


def _range(values: Channel) -> tuple[float, float]:
    """Between what values lie, but for a few at both ends."""
    low, high = np.percentile(values, [_EDGE, 100.0 - _EDGE])
    return (float(low), float(high)) if high > low else (float(low) - 0.5, float(low) + 0.5)
