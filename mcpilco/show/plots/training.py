"""Plots of a whole training: what each trial cost, how the search went, what it took."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mcpilco.show.plots.style import (
    MODEL,
    PARTICLES,
    SYSTEM,
    add_legend,
    new_axes,
    trial_shades,
)
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Judged(Protocol):
    """The numbers of a trial for the learning curve; a `TrialResult` has it."""

    @property
    def experience_s(self) -> float:
        """Duration of the data that the policy was learned from [s]."""
        ...

    @property
    def predicted_cost(self) -> float:
        """Cost of an episode as the model predicted it [-]."""
        ...

    @property
    def predicted_cost_std(self) -> float:
        """Its standard deviation over particles [-]."""
        ...

    @property
    def real_cost(self) -> float:
        """Cost of the episode on the system [-]."""
        ...

    @property
    def success(self) -> bool | None:
        """Whether the env called it one; None where it does not tell."""
        ...


def plot_learning(results: Sequence[Judged], ax: Axes | None = None) -> Axes:
    """The cost of each trial over the experience behind it; a success is filled.

    The band is the predicted cost plus and minus its standard deviation over particles.

    Args:
        results: the trials of one run, in order.
        ax: where to draw; a new figure without it.

    Raises:
        InputError: there are no trials, or matplotlib is missing.
    """
    if not results:
        raise InputError(
            "plot_learning needs at least one trial, got none; let the agent learn first."
        )
    ax = new_axes()[0] if ax is None else ax
    experience = np.array([r.experience_s for r in results])
    predicted = np.array([r.predicted_cost for r in results])
    std = np.array([r.predicted_cost_std for r in results])
    real = np.array([r.real_cost for r in results])
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

    Args:
        costs: of the steps, by trial [-].
        ax: where to draw; a new figure without it.
    """
    ax = new_axes()[0] if ax is None else ax
    for (trial, values), shade in zip(costs.items(), trial_shades(len(costs)), strict=True):
        steps = np.arange(1, len(values) + 1)
        ax.plot(steps, values, color=shade, linewidth=1, label=f"trial {trial}")
    ax.set(xlabel="step of the policy search", ylabel="predicted cost [-]", ylim=(0, None))
    add_legend(ax)
    return ax


def plot_times(
    trials: Sequence[int],
    wall_s: Sequence[float],
    cpu_s: Sequence[float],
    ax: Axes | None = None,
) -> Axes:
    """Time of each trial: time on the clock, and of the processor.

    Args:
        trials: their numbers.
        wall_s: by the clock [s].
        cpu_s: of the processor [s].
        ax: where to draw; a new figure without it.
    """
    ax = new_axes()[0] if ax is None else ax
    places = np.asarray(trials, dtype=float)
    ax.bar(places - 0.2, wall_s, 0.4, color=PARTICLES, label="clock")
    ax.bar(places + 0.2, cpu_s, 0.4, color=MODEL, label="processor")
    ax.set(xlabel="trial", ylabel="time [s]", xticks=list(trials))
    add_legend(ax)
    return ax
