"""The pictures: the angle as each model predicts it, and how good the predictions are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from harness import write_picture
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from model_learning.forecasts import Forecast
from model_learning.tables import SHOWN, Gathered

from mcpilco.show.plots import MODEL, PARTICLES, SYSTEM, add_legend

_LINES = 60
"""particles that are drawn"""
_COLOURS = {"pilco": "tab:red", "rbf": "tab:orange", "mpk": "tab:green", "rbf+mpk": "tab:blue"}
_BEYOND = 2.5 * np.pi
"""angles farther from the true ones are not shown [rad]"""


@dataclass(frozen=True)
class Example:
    """A rollout and a forecast of it."""

    kind: str
    model: str
    times: Float[np.ndarray, " T_plus_1"]
    truth: Float[np.ndarray, " T_plus_1"]
    """the pole's angle [rad]"""
    forecast: Forecast
    angle: int
    """its index"""


def write_example(path: Path, examples: Sequence[Example]) -> None:
    """The pole's angle over time: a row a kind of rollout, a column a model.

    Reference: thesis figures 5.4 and 5.5, at the top.
    """
    kinds = list(dict.fromkeys(example.kind for example in examples))
    columns = len(examples) // len(kinds)
    figure = Figure(figsize=(2.9 * columns, 2.5 * len(kinds)), layout="constrained")
    axes = figure.subplots(len(kinds), columns, squeeze=False, sharex=True, sharey="row")
    for ax, example in zip(axes.flat, examples, strict=True):
        plot_example(example, ax)
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    for ax, kind in zip(axes[:, 0], kinds, strict=True):
        ax.set_ylabel(f"{kind}: pole angle [rad]")
    write_picture(path, figure)


def plot_example(example: Example, ax: Axes) -> Axes:
    """The true angle and the predicted ones: particles, or the 95 % interval of a Gaussian."""
    forecast, times = example.forecast, example.times
    low, high = forecast.interval()[..., example.angle]
    ax.fill_between(times, low, high, color=PARTICLES, alpha=0.3, linewidth=0, label="95 %")
    if forecast.particles is None:
        ax.plot(times, forecast.mean[:, example.angle], color=MODEL, label="mean")
    else:
        shown = forecast.particles[:, :_LINES, example.angle]
        ax.plot(times, shown, color=MODEL, alpha=0.4, linewidth=0.5, rasterized=True)
    ax.plot(times, example.truth, ".-", color=SYSTEM, markersize=4, linewidth=0.8, label="system")
    ax.set_ylim(example.truth.min() - _BEYOND, example.truth.max() + _BEYOND)
    ax.set_title(SHOWN[example.model], fontsize="medium")
    return ax


def write_errors(path: Path, found: Gathered) -> None:
    """Error, coverage and likelihood over the horizon, a row a kind of rollout.

    Reference: thesis figure 5.5, at the bottom.
    """
    kinds = list(dict.fromkeys(kind for kind, _ in found))
    figure = Figure(figsize=(11.5, 2.9 * len(kinds)), layout="constrained")
    axes = figure.subplots(len(kinds), 3, squeeze=False, sharex=True)
    for row, kind in zip(axes, kinds, strict=True):
        of_it = {model: columns for (k, model), columns in found.items() if k == kind}
        plot_band(of_it, "rmse_angle", row[0])
        row[0].set(ylabel=f"{kind}: RMSE of the angle [rad]", yscale="log")
        plot_coverage(of_it, row[1])
        plot_band(of_it, "nll", row[2])
        row[2].set_yscale("symlog", linthresh=10.0)
        row[2].set_ylabel("negative log-likelihood [nats]")
    add_legend(axes[0, 0])
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    write_picture(path, figure)


def plot_band(of_it: Mapping[str, Mapping[str, np.ndarray]], column: str, ax: Axes) -> Axes:
    """Median over seeds and the quartiles as a band."""
    for model, columns in of_it.items():
        low, middle, high = np.quantile(columns[column], (0.25, 0.5, 0.75), axis=0)
        colour, times = _COLOURS[model], columns["time_s"]
        ax.fill_between(times, low, high, color=colour, alpha=0.15, linewidth=0)
        ax.plot(times, middle, color=colour, label=SHOWN[model])
    return ax


def plot_coverage(of_it: Mapping[str, Mapping[str, np.ndarray]], ax: Axes) -> Axes:
    """Share of rollouts whose angle lies in the central 95 %."""
    for model, columns in of_it.items():
        share = 100 * columns["covered_angle"].mean(0)
        ax.plot(columns["time_s"], share, color=_COLOURS[model])
    ax.axhline(95.0, color=SYSTEM, linewidth=1, linestyle=":")
    ax.set(ylabel="truth within 95 % interval [%]", ylim=(0, 102))
    return ax
