"""The pictures of the comparison."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from cartpole_swingup.run import EXPERIENCE, PUBLISHED
from harness import write_picture
from matplotlib.figure import Figure

from mcpilco.show.plots import SYSTEM, Curve, plain_log_axis, plot_curves
from mcpilco.sweep import Measure, Run, estimate, measure_of

_LINES = {"MC-PILCO": "--", "PILCO": ":"}
"""of the thesis's figures"""


def write_trials(path: Path, runs: Sequence[Run], published: bool) -> None:
    """Time up, distance and return after each trial: means and standard deviations over seeds.

    Args:
        path: of the picture.
        runs: what learns by trials.
        published: whether the thesis has figures for this system.

    Reference: thesis figure 5.2.
    """
    figure = Figure(figsize=(11.5, 3.2), layout="constrained")
    axes = figure.subplots(1, 3)
    for ax, key in zip(axes, ("time_up_s", "mean_abs_cart_m", "return"), strict=True):
        measure = measure_of(key)
        plot_curves({k: _spread(run, measure) for k, run in enumerate(runs)}, measure.title, ax)
        for name, values in PUBLISHED.get(key, {}).items() if published else ():
            ax.plot(EXPERIENCE, values, _LINES[name], color=SYSTEM, label=f"{name}, thesis")
    _add_legend(figure)
    write_picture(path, figure)


def write_experience(path: Path, runs: Sequence[Run]) -> None:
    """Success over experience and over processor time, with 95 % bootstrap intervals over seeds."""
    figure = Figure(figsize=(11.5, 3.6), layout="constrained")
    axes = figure.subplots(1, 2)
    measure = measure_of("p")
    curves = {place: _interval(run, measure) for place, run in enumerate(runs)}
    plot_curves(curves, measure.title, axes[0])
    spent = {place: _over_time(curve, runs[place]) for place, curve in curves.items()}
    plot_curves(spent, measure.title, axes[1])
    axes[1].set_xlabel("processor time so far, median [s]")
    for ax in axes:
        plain_log_axis(ax)
    _add_legend(figure)
    write_picture(path, figure)


def _add_legend(figure: Figure) -> None:
    """A legend above all panels, for the bands fill them."""
    lines, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(lines, names, loc="outside upper center", ncols=len(names), frameon=False)


def _over_runs(run: Run, curve: Callable[[float], tuple[float, float, float]]) -> Curve:
    amounts = run.amounts
    columns = np.array([curve(float(amount)) for amount in amounts]).T
    return Curve(run.name, amounts, *columns)


def _spread(run: Run, measure: Measure) -> Curve:
    def at(amount: float) -> tuple[float, float, float]:
        values = measure.scale * np.array(list(run.at(amount, measure.key).values()))
        mean, std = values.mean(), values.std(ddof=1) if len(values) > 1 else 0.0
        return mean, mean - std, mean + std

    return _over_runs(run, at)


def _interval(run: Run, measure: Measure) -> Curve:
    def at(amount: float) -> tuple[float, float, float]:
        found = estimate(list(run.at(amount, measure.key).values()), measure, "mean")
        missing = found.low is None
        return found.value, np.nan if missing else found.low, np.nan if missing else found.high

    return _over_runs(run, at)


def _over_time(curve: Curve, run: Run) -> Curve:
    """The same over processor time."""
    spent = [np.median(list(run.at(float(a), "cpu_s").values())) for a in curve.experience_s]
    return Curve(curve.name, np.array(spent), curve.values, curve.low, curve.high)
