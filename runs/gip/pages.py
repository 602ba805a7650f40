"""Tables and pictures of what was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import fill, places, write_picture
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mcpilco.sweep import markdown

Trials = Sequence[Mapping[str, Any]]

COLOURS = {
    "fe": "tab:gray",
    "pp": "tab:green",
    "sp": "tab:olive",
    "gip": "tab:blue",
    "rbf": "tab:orange",
    "nn": "tab:red",
}


def write(out: Path, found: Mapping[str, Trials], template: Path) -> None:
    """Put pictures and tables of all results into README.md."""
    parts = []
    if "scara" in found:
        _boxes(out / "scara.png", found["scara"])
        parts += scara(found["scara"])
    if "efficiency" in found:
        _curves(out / "efficiency.png", found["efficiency"])
        parts += efficiency(found["efficiency"])
    if "ur10" in found:
        _boxes(out / "ur10.png", found["ur10"])
        parts += ur10(found["ur10"])
    for name, told in (
        ("ur10-efficiency", six_joint_efficiency),
        ("unexplained", unexplained),
        ("recorded", recorded),
    ):
        if name in found:
            parts += told(found[name])
    fill(
        out / "README.md",
        [*parts, places((t for trials in found.values() for t in trials), ", one thread")],
        template=template,
    )


def scara(trials: Trials) -> list[str]:
    return [
        "### Perturbed SCARAs",
        f"nMSE on a motion of its own, {_setting(trials)}.",
        "![Figure 3.2](scara.png)",
        errors(trials),
        demands(trials),
        "### Forward dynamics and feed-forward control of the same robots",
        "Share of 200 positions where the learned inertia matrix is positive definite [%], and "
        "nMSE of the accelerations there, from true torques: medians.",
        forward(trials),
        "RMS error of each joint on a new motion of 5 s [mrad, at the quill mm], medians: feedback "
        "alone, and with the torques of a model fed forward.",
        tracking(trials),
    ]


def ur10(trials: Trials) -> list[str]:
    return [
        "### Arms like a UR10",
        f"nMSE on a motion of its own, {_setting(trials)}.",
        "![Figure 3.4, of simulated arms](ur10.png)",
        errors(trials),
        _below(trials, "rbf", 1.0),
    ]


def _setting(trials: Trials) -> str:
    return (
        f"robots: {len(trials)}, {trials[0]['samples']} samples each: median (least to greatest) "
        "over the robots"
    )


def nmse(trials: Trials, name: str) -> np.ndarray:
    """(robots, joints)."""
    return np.array([trial["nmse"][name] for trial in trials])


def errors(trials: Trials) -> str:
    joints = trials[0]["joints"]
    rows = []
    for name in trials[0]["nmse"]:
        cpu = np.median([trial["cpu_s"][name] for trial in trials])
        cells = (
            f"{np.median(c):.1e} ({c.min():.0e} to {c.max():.0e})" for c in nmse(trials, name).T
        )
        rows.append((f"`{name}`", *cells, f"{cpu:.1f}"))
    return markdown(("estimator", *joints, "CPU [s]"), rows)


def demands(trials: Trials) -> str:
    """What was asked of GIP before it was measured."""
    gip = np.median(nmse(trials, "gip"), 0)
    lines = [
        f"- `gip` at most 5e-3 on joints 1 to 3, 5e-2 on joint 4: "
        f"{_yes((gip[:3] <= 5e-3).all() and gip[3] <= 5e-2)}",
        _below(trials, "rbf", 0.2, (0, 1, 3)),
        _below(trials, "pp", 1.0),
    ]
    return "\n".join(lines)


def _below(trials: Trials, other: str, factor: float, joints: Sequence[int] | None = None) -> str:
    ratios = np.median(nmse(trials, "gip"), 0) / np.median(nmse(trials, other), 0)
    chosen = range(len(ratios)) if joints is None else joints
    told = ", ".join(f"{ratio:.2g}" for ratio in ratios)
    which = "all joints" if joints is None else f"joints {', '.join(str(j + 1) for j in chosen)}"
    return (
        f"- ratio of the medians of `gip` and `{other}`: {told}; below {factor:g} on {which}: "
        f"{_yes(all(ratios[j] <= factor for j in chosen))}"
    )


def _yes(answer: bool) -> str:
    return "yes" if answer else "**no**"


def forward(trials: Trials) -> str:
    rows = []
    for name in trials[0]["forward"]:
        each = [trial["forward"][name] for trial in trials]
        whole = [row["nmse"] for row in each if None not in row["nmse"]]
        cells = [f"{value:.1e}" for value in np.median(whole, 0)] if whole else ["-"] * 4
        share = 100 * np.array([row["positive"] for row in each])
        spread = f"{np.median(share):.0f} ({share.min():.0f} to {share.max():.0f})"
        rows.append((f"`{name}`", spread, *cells))
    return markdown(("estimator", "positive definite [%]", *trials[0]["joints"]), rows)


def tracking(trials: Trials) -> str:
    rows = [
        (f"`{name}`", *(f"{1e3 * value:.2f}" for value in _median(trials, "tracking", name)))
        for name in trials[0]["tracking"]
    ]
    return markdown(("feed-forward", *trials[0]["joints"]), rows)


def _median(trials: Trials, what: str, name: str) -> np.ndarray:
    return np.median([trial[what][name] for trial in trials], 0)


def efficiency(trials: Trials) -> list[str]:
    samples = trials[0]["samples"]
    rows = [
        (f"`{name}`", *(f"{value:.1e}" for value in _median(trials, "gmse", name)))
        for name in trials[0]["gmse"]
    ]
    return [
        "### Data efficiency",
        "Squared errors of the four joints, summed, over the number of training samples; the "
        "nominal robot, so that `pp` knows the true geometry. Medians of "
        f"{len(trials)} seeds.",
        "![Figure 3.3](efficiency.png)",
        markdown(("estimator", *map(str, samples)), rows),
    ]


def six_joint_efficiency(trials: Trials) -> list[str]:
    counts, joints = trials[0]["samples"], trials[0]["joints"]
    rows = []
    for name in trials[0]["nmse"]:
        medians = np.median([trial["nmse"][name] for trial in trials], 0)  # counts, joints
        rows += [
            (f"`{name}`", str(count), *(f"{value:.1e}" for value in row))
            for count, row in zip(counts, medians, strict=True)
        ]
    return [
        "### Six joints take more data",
        f"nMSE over the number of samples, medians of {len(trials)} of these arms.",
        markdown(("estimator", "samples", *joints), rows),
    ]


def unexplained(trials: Trials) -> list[str]:
    rows = []
    for name, how in (("evidence", "highest evidence"), ("left out", "stretches left out")):
        each = nmse(trials, name)
        cells = (f"{np.median(c):.1e} ({c.min():.0e} to {c.max():.0e})" for c in each.T)
        rows.append((how, *cells))
    ratios = [f"{r:.2g}" for r in np.median(nmse(trials, "evidence") / nmse(trials, "left out"), 0)]
    return [
        "### Forces that no motion explains",
        f"nMSE of `gip` on a motion without such forces, {_setting(trials)}. Those it learned from "
        "have a smooth random force besides, of 15 % of each torque's standard deviation.",
        markdown(("hyperparameters by", *trials[0]["joints"]), rows),
        f"Medians of the ratio of the two: {', '.join(ratios)}.",
    ]


def recorded(trials: Trials) -> list[str]:
    (trial,) = trials
    parts = ["### A real UR10"]
    for where, found in trial["nmse"].items():
        rows = [
            (f"`{name}`", str(count), *(f"{value:.2g}" for value in row))
            for name, each in found.items()
            for count, row in zip(trial["samples"], each, strict=True)
        ]
        parts += [
            f"nMSE on the {where}.",
            markdown(("estimator", "samples", *trial["joints"]), rows),
        ]
    return parts


# Pictures -----------------------------------------------------------------------------------------


def _boxes(path: Path, trials: Trials) -> None:
    """nMSE by joint and estimator, a box over the robots: thesis figures 3.2 and 3.4."""
    joints, names = trials[0]["joints"], list(trials[0]["nmse"])
    figure = Figure(figsize=(1.9 * len(joints), 2.8), layout="constrained")
    axes = figure.subplots(1, len(joints), sharey=True)
    for j, (joint, ax) in enumerate(zip(joints, axes, strict=True)):
        drawn = ax.boxplot(
            [nmse(trials, name)[:, j] for name in names],
            patch_artist=True,
            widths=0.7,
            flierprops={"markersize": 3},
            medianprops={"color": "black"},
        )
        for box, name in zip(drawn["boxes"], names, strict=True):
            box.set_facecolor(COLOURS[name])
        ax.set(title=joint, yscale="log", xticks=range(1, len(names) + 1), xticklabels=names)
        ax.grid(axis="y", alpha=0.3)
    axes[0].set_ylabel("nMSE [-]")
    write_picture(path, figure)


def _curves(path: Path, trials: Trials) -> None:
    """Squared error over the amount of data: thesis figure 3.3."""
    figure = Figure(figsize=(4.6, 3.2), layout="constrained")
    ax: Axes = figure.subplots()
    samples = trials[0]["samples"]
    for name in trials[0]["gmse"]:
        values = np.array([trial["gmse"][name] for trial in trials])
        ax.plot(samples, np.median(values, 0), "o-", color=COLOURS[name], label=name, markersize=4)
        ax.fill_between(samples, values.min(0), values.max(0), color=COLOURS[name], alpha=0.2)
    ax.set(
        xscale="log",
        yscale="log",
        xlabel="training samples",
        ylabel="summed squared error [N² m² and N²]",
        xticks=samples,
        xticklabels=samples,
    )
    ax.minorticks_off()
    ax.legend(frameon=False, fontsize="small")
    write_picture(path, figure)
