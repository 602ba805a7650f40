"""Figures 4.2 and 4.3 of the thesis, of the simulated arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import write_picture
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from mcpilco.show.plots import MODEL, PARTICLES, SYSTEM, add_legend

COLOURS = {"PP": "tab:red", "SP": "tab:orange", "FC": MODEL, "PP of motions": PARTICLES}


def write_errors(path: Path, trials: Sequence[Mapping[str, Any]]) -> None:
    """Errors of each joint in motion and at rest, medians over arms, with their range.

    Reference: thesis figure 4.2.
    """
    figure = Figure(figsize=(7.5, 4.6), layout="constrained")
    kinds, joints = list(trials[0]["rmse"]), trials[0]["joints"]
    for ax, (phase, word) in zip(
        figure.subplots(2, 1, sharex=True),
        (("moving", "in motion"), ("resting", "at rest")),
        strict=True,
    ):
        for k, kind in enumerate(kinds):
            values = np.array([trial["rmse"][kind][phase] for trial in trials])
            middle = np.median(values, axis=0)
            ends = np.abs(np.array([values.min(axis=0), values.max(axis=0)]) - middle)
            places = np.arange(len(joints)) + 0.2 * (k - 1.5)
            ax.bar(places, middle, 0.18, color=COLOURS[kind], label=kind)
            ax.errorbar(places, middle, yerr=ends, fmt="none", ecolor=SYSTEM, linewidth=0.8)
        ax.set(ylabel=f"RMSE {word} [A]", yscale="log", xticks=range(len(joints)))
        ax.set_xticklabels(joints)
        ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        ax.yaxis.set_minor_locator(NullLocator())
    add_legend(figure.axes[0])
    write_picture(path, figure)


def write_currents(path: Path, shown: Mapping[str, np.ndarray]) -> None:
    """The first joint's current and what is expected, and the residuals with their thresholds.

    Reference: thesis figures 4.1 and 4.3.
    """
    figure = Figure(figsize=(8.5, 6.5), layout="constrained")
    velocity, current, *residuals = figure.subplots(4, 1, sharex=True)
    time = shown["time"]
    for ax in figure.axes:
        for start, end in zip(shown["starts"], shown["ends"], strict=True):
            ax.axvspan(start, end, color=PARTICLES, alpha=0.35, linewidth=0)
    velocity.plot(time, shown["velocity"], color=SYSTEM, linewidth=0.8)
    velocity.set_ylabel("velocity [rad/s]")
    current.plot(time, shown["current"], color=SYSTEM, linewidth=0.8, label="measured")
    for kind in ("SP", "FC"):
        current.plot(
            time, shown[f"expected_{kind}"], color=COLOURS[kind], linewidth=0.8, label=kind
        )
    current.set_ylabel("current [A]")
    current.legend(
        frameon=False, fontsize="small", ncols=3, loc="lower left", bbox_to_anchor=(0, 0.97)
    )
    for ax, kind in zip(residuals, ("SP", "FC"), strict=True):
        limit = float(shown[f"threshold_{kind}"][0])
        residual = shown["current"] - shown[f"expected_{kind}"]
        ax.plot(time, residual, color=COLOURS[kind], linewidth=0.8)
        for sign in (-1, 1):
            ax.axhline(sign * limit, color=SYSTEM, linewidth=0.8, linestyle=":")
        ax.set_ylabel(f"residual of {kind} [A]")
    residuals[-1].set(xlabel="time [s]", xlim=(time[0], time[-1]))
    write_picture(path, figure)
