"""Plots of one rollout over time, beside the particles predicted for it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from mcpilco.data import Prediction, Rollout
from mcpilco.show.plots.style import MODEL, SYSTEM, Line, add_legend, draw_particles, new_axes
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def plot_states(
    rollout: Rollout,
    prediction: Prediction | None,
    task: TaskSpec,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> list[Axes]:
    """One plot for each state: the system over time, and the particles predicted for it.

    Raises:
        InputError: `axes` do not fit the states, or matplotlib is missing.
    """
    names = task.state_names
    axes = new_axes(len(names)) if axes is None else list(np.asarray(axes, dtype=object).flat)
    if len(axes) != len(names):
        raise InputError(
            f"plot_states needs one axis for each of the states {names}, got {len(axes)}."
        )
    for i, ax in enumerate(axes):
        plot_state(rollout, prediction, task, i, ax)
    add_legend(axes[0])
    return axes


def plot_state(
    rollout: Rollout,
    prediction: Prediction | None,
    task: TaskSpec,
    state: int,
    ax: Axes | None = None,
) -> Axes:
    """One state of the system over time, and the particles predicted for it; without a legend.

    Reference: thesis figures 5.3 and 5.4.
    """
    ax = new_axes()[0] if ax is None else ax
    if prediction is not None:
        draw_particles(ax, rollout.dt, prediction.states[:, :, state], np.median)
    ax.plot(rollout.times, rollout.shown_states[:, state], color=SYSTEM, label="system")
    if state in task.measured_states and (
        rollout.states is not None or rollout.smoothed is not None
    ):
        seen = rollout.observations[:, task.measured_states.index(state)]
        ax.plot(rollout.times, seen, ".", color=SYSTEM, markersize=3, label="observed")
    ax.set(xlabel="time [s]", ylabel=f"{task.state_names[state]} [{task.state_units[state]}]")
    return ax


def plot_promise(
    promised: Line, happened: Float[np.ndarray, " S"], dt: float, label: str, ax: Axes | None = None
) -> Axes:
    """A state over time: as a simulation promised it, and as it was on the system."""
    ax = new_axes()[0] if ax is None else ax
    times = dt * np.arange(max(len(promised), len(happened)))
    # the first is seen beneath the other
    ax.plot(times[: len(promised)], promised, color=MODEL, linewidth=3.5, label="promised")
    ax.plot(times[: len(happened)], happened, color=SYSTEM, label="on the system")
    ax.set(xlabel="time [s]", ylabel=label)
    add_legend(ax)
    return ax


def plot_input(
    rollout: Rollout,
    prediction: Prediction | None,
    task: TaskSpec,
    index: int,
    ax: Axes | None = None,
) -> Axes:
    """One input over time, held through each step, and those of the particles."""
    ax = new_axes()[0] if ax is None else ax
    if prediction is not None:
        draw_particles(ax, rollout.dt, prediction.inputs[:, :, index], np.median, held=True)
    inputs = rollout.inputs[:, index]
    ax.plot(rollout.times[:-1], inputs, color=SYSTEM, label="system", drawstyle="steps-post")
    ax.set(xlabel="time [s]", ylabel=f"{task.input_names[index]} [{task.input_units[index]}]")
    return ax


def plot_costs(
    costs: Line | None, prediction: Prediction | None, dt: float, ax: Axes | None = None
) -> Axes:
    """The cost at the end of each step, on the system and as predicted."""
    ax = new_axes()[0] if ax is None else ax
    if prediction is not None:
        draw_particles(ax, dt, prediction.costs, np.mean, first=1)
    if costs is not None:
        ax.plot(dt * np.arange(1, len(costs) + 1), costs, color=SYSTEM, label="system")
    ax.set(xlabel="time [s]", ylabel="cost [-]")
    add_legend(ax)
    return ax
