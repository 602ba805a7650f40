"""Plots for reports: the system black, the model blue, its particles grey, their spread as a band.

matplotlib comes with the extra `report` and is imported when the first plot is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from mcpilco.costs import costs_along
from mcpilco.data import Prediction, Rollout, TrialResult
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SYSTEM, _MODEL, _PARTICLES = "black", "tab:blue", "0.55"
_QUANTILES = (5, 95)
"""between which the band lies [%]"""
_PANEL_INCHES = (4.2, 2.6)


def plot_states(
    rollout: Rollout,
    prediction: Prediction | None,
    task: TaskSpec,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> list[Axes]:
    """One plot for each state: the system over time, and the particles predicted for it.

    Args:
        rollout: the episode on the system.
        prediction: its particles; None leaves the system alone.
        task: names and units.
        axes: where to draw, one for each state; a new figure of two columns without it.

    Raises:
        InputError: `axes` do not fit the states, or matplotlib is missing.
    """
    names = task.state_names
    axes = _grid(len(names)) if axes is None else list(np.asarray(axes, dtype=object).flat)
    if len(axes) != len(names):
        raise InputError(
            f"plot_states needs one axis for each of the states {names}, got {len(axes)}."
        )
    for i, ax in enumerate(axes):
        if prediction is not None:
            particles = prediction.states[:, :, i]
            _band(ax, _times(rollout, 0, len(particles)), particles)
            ax.plot(
                _times(rollout, 0, len(particles)),
                np.median(particles, axis=1),
                color=_MODEL,
                label="median",
            )
        ax.plot(rollout.times, rollout.shown_states[:, i], color=_SYSTEM, label="system")
        if i in task.observed and (rollout.states is not None or rollout.smoothed is not None):
            ax.plot(
                rollout.times,
                rollout.observations[:, task.observed.index(i)],
                ".",
                color=_SYSTEM,
                markersize=3,
                label="observed",
            )
        ax.set(xlabel="time [s]", ylabel=f"{names[i]} [{task.state_units[i]}]")
    axes[0].legend(frameon=False, fontsize="small")
    return axes


def plot_costs(
    rollout: Rollout, prediction: Prediction | None, task: TaskSpec, ax: Axes | None = None
) -> Axes:
    """The cost at the end of each step, on the system and as predicted.

    Args:
        rollout: the episode on the system.
        prediction: its particles; None leaves the system alone.
        task: says what a state costs.
        ax: where to draw; a new figure without it.
    """
    ax = _grid(1)[0] if ax is None else ax
    if prediction is not None:
        times = _times(rollout, 1, len(prediction.costs))
        _band(ax, times, prediction.costs)
        ax.plot(times, prediction.costs.mean(axis=1), color=_MODEL, label="mean")
    costs = costs_along(task.cost, rollout.shown_states[1:], rollout.inputs)
    ax.plot(_times(rollout, 1, len(rollout)), costs, color=_SYSTEM, label="system")
    ax.set(xlabel="time [s]", ylabel="cost [-]")
    ax.legend(frameon=False, fontsize="small")
    return ax


def plot_learning(results: Sequence[TrialResult], ax: Axes | None = None) -> Axes:
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
    ax = _grid(1)[0] if ax is None else ax
    experience = np.array([r.experience_s for r in results])
    predicted = np.array([r.predicted_cost for r in results])
    std = np.array([r.predicted_cost_std for r in results])
    real = np.array([r.real_cost for r in results])
    solved = [bool(r.success) for r in results]
    low, high = predicted - std, predicted + std
    ax.fill_between(experience, low, high, color=_PARTICLES, alpha=0.4, linewidth=0)
    ax.plot(experience, predicted, color=_MODEL, label="predicted")
    ax.plot(experience, real, color=_SYSTEM, label="system")
    faces = [_SYSTEM if s else "white" for s in solved]
    ax.scatter(experience, real, c=faces, edgecolors=_SYSTEM, zorder=3)
    ax.set(xlabel="experience [s]", ylabel="cost of an episode [-]")
    ax.legend(frameon=False, fontsize="small")
    return ax


def _band(ax: Axes, times: Float[np.ndarray, " T"], particles: Float[np.ndarray, "T P"]) -> None:
    low, high = np.percentile(particles, _QUANTILES, axis=1)
    label = f"particles, {_QUANTILES[0]} to {_QUANTILES[1]} %"
    ax.fill_between(times, low, high, color=_PARTICLES, alpha=0.4, linewidth=0, label=label)


def _times(rollout: Rollout, first: int, rows: int) -> Float[np.ndarray, " T"]:
    """Times of the steps first, first + 1, ... [s]."""
    return rollout.dt * np.arange(first, first + rows)


def _grid(count: int) -> list[Axes]:
    """So many axes of a new figure, in two columns."""
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
