"""Plots of trainings: costs, searches, times; predictions, policies; several runs together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from mcpilco.data import TrialResult
from mcpilco.logbook import PastTrial
from mcpilco.show.plots.style import (
    MODEL,
    PARTICLES,
    SYSTEM,
    add_legend,
    new_axes,
    plain_ticks,
    trial_shades,
)
from mcpilco.sweep import FACTORS
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from mcpilco.sweep import Direction


_STYLES = ("-", "--", "-.", ":")
_CHANCE = 1.96
"""95 % of a normal distribution lie within so many standard deviations"""


def plot_learning(
    results: Sequence[TrialResult] | Sequence[PastTrial], ax: Axes | None = None
) -> Axes:
    """The cost of each trial over the experience behind it; a success is filled.

    The band is the predicted cost plus and minus its standard deviation over particles.

    Raises:
        InputError: there are no trials, or matplotlib is missing.
    """
    if not results:
        raise InputError(
            "plot_learning needs at least one trial, got none; let the agent learn first."
        )
    ax = new_axes()[0] if ax is None else ax
    rows = [(r.experience_s, r.predicted_cost, r.predicted_cost_std, r.real_cost) for r in results]
    experience, predicted, std, real = np.array(rows, dtype=float).T
    low, high = predicted - std, predicted + std
    ax.fill_between(experience, low, high, color=PARTICLES, alpha=0.4, linewidth=0)
    ax.errorbar(experience, predicted, std, color=MODEL, capsize=2, marker=".", label="predicted")
    ax.plot(experience, real, color=SYSTEM, label="system")
    faces = [SYSTEM if r.success else "white" for r in results]
    ax.scatter(experience, real, c=faces, edgecolors=SYSTEM, zorder=3)
    ax.set(xlabel="experience [s]", ylabel="cost of an episode [-]", ylim=(0, None))
    add_legend(ax)
    return ax


def plot_search(costs: Mapping[int, Sequence[float]], ax: Axes | None = None) -> Axes:
    """The cost that the model expects, after each step of each trial's policy search.

    Where a search tried several starts, they follow one another.
    """
    ax = new_axes()[0] if ax is None else ax
    for (trial, values), shade in zip(costs.items(), trial_shades(len(costs)), strict=True):
        steps = np.arange(1, len(values) + 1)
        ax.plot(steps, values, color=shade, linewidth=1, label=f"trial {trial}")
    ax.set(xlabel="step of the policy search", ylabel="predicted cost [-]", ylim=(0, None))
    add_legend(ax)
    return ax


def plot_directions(found: Sequence[Direction], ax: Axes | None = None) -> Axes:
    """Success of a policy over each number of the plant, the others as they are."""
    ax = new_axes()[0] if ax is None else ax
    for number, one in enumerate(found):
        style = _STYLES[number // 10 % len(_STYLES)]
        ax.plot(FACTORS, np.multiply(one.success, 100.0), marker=".", ls=style, label=one.name)
    ax.set(xlabel="times its own value [-]", ylabel="success [%]", ylim=(-4, 104))
    add_legend(ax)
    return ax


def plot_times(
    trials: Sequence[int], wall_s: Sequence[float], cpu_s: Sequence[float], ax: Axes | None = None
) -> Axes:
    """Time of each trial: time on the clock, and of the processor."""
    ax = new_axes()[0] if ax is None else ax
    places = np.asarray(trials, dtype=float)
    ax.bar(places - 0.2, wall_s, 0.4, color=PARTICLES, label="clock")
    ax.bar(places + 0.2, cpu_s, 0.4, color=MODEL, label="processor")
    ax.set(xlabel="trial", ylabel="time [s]", xticks=list(trials))
    add_legend(ax)
    return ax


def plot_coverage(
    levels: Float[np.ndarray, " L"],
    covered: Mapping[str, Float[np.ndarray, " L"]],
    count: int | None,
    ax: Axes | None = None,
) -> Axes:
    """How often the truth lies within the predicted interval, over the interval's level.

    On the diagonal the spread is right, below it too small, above it too large.

    Levels are nominal, in (0, 1); `covered` are the shares found, by output. The band, none without
    the `count` of predictions that each share is of, is where 95 % of the shares of a calibrated
    model lie, were the predictions independent.
    """
    ax = new_axes()[0] if ax is None else ax
    if count:
        chance = _CHANCE * np.sqrt(levels * (1 - levels) / count)
        ax.fill_between(
            levels, levels - chance, levels + chance, color=PARTICLES, alpha=0.3, linewidth=0
        )
    ax.plot([0, 1], [0, 1], color=PARTICLES, linewidth=1)
    for i, (name, shares) in enumerate(covered.items()):
        ax.plot(levels, shares, _STYLES[i % len(_STYLES)], color=MODEL, label=name)
    ax.set(
        xlabel="level of the interval [-]", ylabel="truth within [-]", xlim=(0, 1), ylim=(0, 1.02)
    )
    add_legend(ax)
    return ax


def plot_errors(
    errors: Mapping[int, Float[np.ndarray, " T"]],
    dt: float,
    name: str,
    unit: str,
    ax: Axes | None = None,
) -> Axes:
    """How far the particles are from the system, along the rollout, a line a trial.

    Errors are root mean squares over the particles, in the state's unit.

    Reference: thesis figure 5.5, at the bottom.
    """
    ax = new_axes()[0] if ax is None else ax
    for (trial, values), shade in zip(errors.items(), trial_shades(len(errors)), strict=True):
        ax.plot(dt * np.arange(len(values)), values, color=shade, label=f"trial {trial}")
    ax.set(xlabel="time [s]", ylabel=f"error of {name} [{unit}]", ylim=(0, None))
    add_legend(ax)
    return ax


@dataclass(frozen=True)
class PolicyMap:
    """One input of a policy over two states, the others held."""

    x: Float[np.ndarray, " A"]
    """values of the first state, in its unit"""
    y: Float[np.ndarray, " B"]
    """values of the second"""
    values: Float[np.ndarray, "B A"]
    """the input, in its unit"""
    path: Float[np.ndarray, "T 2"]
    """where the system went in these two states"""
    low: float
    """smallest input that the policy may give"""
    high: float
    """largest"""
    labels: tuple[str, str, str]
    """names of both states and the input, with their units"""


def plot_policy(policy: PolicyMap, ax: Axes | None = None) -> Axes:
    """The input over two states as colours, and the way that the system took across them."""
    ax = new_axes()[0] if ax is None else ax
    scale: dict[str, Any] = {"cmap": "RdBu_r", "vmin": policy.low, "vmax": policy.high}
    grid = policy.x, policy.y, policy.values
    mesh = ax.pcolormesh(*grid, **scale, shading="gouraud", rasterized=True)
    ax.plot(*policy.path.T, color=SYSTEM, linewidth=1)
    ax.plot(*policy.path[0], "o", color=SYSTEM, markerfacecolor="white")
    ax.plot(*policy.path[-1], "o", color=SYSTEM)
    first, second, label = policy.labels
    ax.set(xlabel=first, ylabel=second)
    ax.figure.colorbar(mesh, ax=ax, label=label)
    return ax


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
