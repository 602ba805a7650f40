"""Plots of what was learned: how far the predictions hold, and what the policy does where."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from mcpilco.show.plots.style import (
    MODEL,
    PARTICLES,
    SYSTEM,
    add_legend,
    new_axes,
    trial_shades,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_STYLES = ("-", "--", "-.", ":")
_CHANCE = 1.96
"""95 % of a normal distribution lie within so many standard deviations"""


def plot_coverage(
    levels: Float[np.ndarray, " L"],
    covered: Mapping[str, Float[np.ndarray, " L"]],
    count: int | None,
    ax: Axes | None = None,
) -> Axes:
    """How often the truth lies within the predicted interval, over the interval's level.

    On the diagonal the spread is right, below it too small, above it too large.

    Args:
        levels: nominal, in (0, 1).
        covered: the shares found, by output.
        count: how many predictions each share is of; the band is where 95 % of the shares of a
            calibrated model lie, were the predictions independent. None draws no band.
        ax: where to draw; a new figure without it.
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
        xlabel="level of the interval [-]",
        ylabel="truth within [-]",
        xlim=(0, 1),
        ylim=(0, 1.02),
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

    Args:
        errors: root mean square over the particles, by trial, in the state's unit.
        dt: sampling time [s].
        name: of the state.
        unit: of the state.
        ax: where to draw; a new figure without it.

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
    """The input over two states as colours, and the way that the system took across them.

    Args:
        policy: what to draw.
        ax: where to draw; a new figure without it.
    """
    ax = new_axes()[0] if ax is None else ax
    mesh = ax.pcolormesh(
        policy.x,
        policy.y,
        policy.values,
        cmap="RdBu_r",
        vmin=policy.low,
        vmax=policy.high,
        shading="gouraud",
        rasterized=True,
    )
    ax.plot(*policy.path.T, color=SYSTEM, linewidth=1)
    ax.plot(*policy.path[0], "o", color=SYSTEM, markerfacecolor="white")
    ax.plot(*policy.path[-1], "o", color=SYSTEM)
    first, second, label = policy.labels
    ax.set(xlabel=first, ylabel=second)
    ax.figure.colorbar(mesh, ax=ax, label=label)
    return ax
