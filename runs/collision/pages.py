"""The page of the claim: tables and pictures of the results that are there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from collision import pictures
from harness import fill, places

from mcpilco.files import read_arrays
from mcpilco.logbook import read_json
from mcpilco.sweep import markdown

Trials = Sequence[Mapping[str, Any]]
PHASES = {"moving": "moving", "resting": "resting", "leaning": "resting, slow"}
ABOUT = {
    "pd": "Feed-forward and PD; the log tells the feed-forward",
    "pid": "Feed-forward and PID; the log tells the whole command",
}


def write_page(out: Path, template: Path, detectors: Iterable[str], either: Sequence[str]) -> None:
    """README.md and the pictures beside it, from all results."""
    parts: list[str] = []
    for controller, about in ABOUT.items():
        paths = sorted((out / "results" / controller).glob("*.json"))
        if not paths:
            continue
        trials = [read_json(path) for path in paths]
        names = [name for name in detectors if all(name in t["detectors"] for t in trials)]
        parts += [f"### {about} (arms: {len(trials)})", *tables(trials, names, either)]
        if controller == "pd":
            shown = read_arrays(paths[0].with_name("shown.npz"))
            pictures.write_errors(out / "errors.png", trials)
            pictures.write_currents(out / "currents.png", shown)
            parts += [
                "![Errors of the currents at rest and in motion](errors.png)",
                "![Currents and residuals of the first joint while it is pushed](currents.png)",
            ]
    found = [read_json(path) for path in (out / "results").glob("*/*.json")]
    cpu = [trial["cpu_s"] for trial in found]
    lines = [places(found)]
    if cpu:
        lines.append(f"- {np.median(cpu):.0f} CPU seconds an arm and controller, in the median")
    fill(out / "README.md", [*parts, "\n".join(lines)], template=template)


def tables(trials: Trials, names: Sequence[str], either: Sequence[str]) -> list[str]:
    return [
        "Root mean square error [A] of samples that nothing was fitted to, joint by joint: median "
        "(least to greatest) over the arms.",
        errors(trials),
        "Friction compensated (FC) beside the others: ratio of errors, median (greatest).",
        ratios(trials),
        "Thresholds of the first joint [A], and samples above them in the free test, all joints.",
        limits(trials, [name for name in names if "of 500" not in name]),
        "Pushes found, in % (median delay [ms]), by their torque about the first joint in parts of "
        "its dry friction; false alarms a minute in the free test.",
        pushes(trials, [*names, "either"], either),
    ]


def spread(values: Sequence[float], digits: int = 3) -> str:
    low, high = min(values), max(values)
    return f"{np.median(values):.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def errors(trials: Trials) -> str:
    joints = trials[0]["joints"]
    rows = [
        (
            kind,
            "at rest" if phase == "resting" else "in motion",
            *(spread([t["rmse"][kind][phase][j] for t in trials]) for j in range(len(joints))),
        )
        for phase in ("resting", "moving")
        for kind in trials[0]["rmse"]
    ]
    return markdown(("model", "", *joints), rows)


def ratios(trials: Trials) -> str:
    joints = trials[0]["joints"]
    rows = []
    for phase, kind in (
        ("resting", "PP"),
        ("resting", "SP"),
        ("moving", "PP"),
        ("moving", "SP"),
        ("moving", "PP of motions"),
    ):
        cells = []
        for j in range(len(joints)):
            ratio = [t["rmse"]["FC"][phase][j] / t["rmse"][kind][phase][j] for t in trials]
            cells.append(f"{np.median(ratio):.2f} ({max(ratio):.2f})")
        rows.append((kind, "at rest" if phase == "resting" else "in motion", *cells))
    return markdown(("FC beside", "", *joints), rows)


def limits(trials: Trials, names: Sequence[str]) -> str:
    rows = []
    for name in names:
        told = [t["detectors"][name] for t in trials]
        ratio = [
            t["detectors"][name]["moving"][0]
            / t["detectors"][name.replace("SP", "PP").replace("FC", "PP")]["moving"][0]
            for t in trials
        ]
        rows.append(
            (
                name,
                spread([d["moving"][0] for d in told], 2),
                spread([d["resting"][0] for d in told], 2),
                spread(ratio, 2),
                f"{100 * np.median([np.mean(d['samples_above']) for d in told]):.2f} %",
            )
        )
    header = ("detector", "in motion", "at rest", "beside PP's, in motion", "samples above")
    return markdown(header, rows)


def pushes(trials: Trials, names: Sequence[str], either: Sequence[str]) -> str:
    first = trials[0]["detectors"][names[0]]
    keys = list(first["pushes"])
    rows = []
    for name in names:
        told = [t["detectors"][name] for t in trials]
        cells = []
        for key in keys:
            delays = [delay for d in told for delay in d["delays_s"][key]]
            share = 100 * len(delays) / sum(d["pushes"][key] for d in told)
            when = f" ({1000 * np.median(delays):.0f})" if delays else ""
            cells.append(f"{share:.0f}{when}")
        false = sum(d["false_alarms"] for d in told) / sum(d["minutes"] for d in told)
        label = " or ".join(f"({part})" for part in either) if name == "either" else name
        rows.append((label, *cells, f"{false:.1f}"))
    titles = [f"{PHASES[phase]} {strength}" for phase, strength in (key.split() for key in keys)]
    count = sum(t["detectors"][names[0]]["pushes"][keys[0]] for t in trials)
    table = markdown(("detector", *titles, "false alarms"), rows)
    return f"{table}\n\n{count} pushes a cell."
