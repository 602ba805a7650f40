"""A picture of a tier: what was hidden against what was named."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import write_picture
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mcpilco.plant import CATALOGUE

OUTSIDE = ("detent", "feed", "patch", "coupling")
HIDDEN = (*CATALOGUE, "none", *OUTSIDE)
NAMED = (*CATALOGUE, "none", "unknown", "too_poor", "refused")
ALWAYS = {"none", "unknown"}
"""verdicts that have a column, whether or not a case got them"""


def confusions(cases: Sequence[Mapping[str, Any]]) -> Counter[tuple[str, str]]:
    """How often each hidden effect was told as what.

    An effect that was named is told as itself; in the place of one that was not stand the named
    effects that were not hidden, a part each, or the verdict where there is none.
    """
    counts: Counter[tuple[str, str]] = Counter()
    for case in cases:
        hidden = [effect.get("kind", effect["name"]) for effect in case["truth"]] or ["none"]
        told = case["found"] if case["verdict"] in ("named", "partly") else ()
        named = [effect["name"] for effect in told]
        others = [name for name in named if name not in hidden]
        if not others:
            others = ["none" if named else case["verdict"]]
        for name in hidden:
            places = [name] if name in named else others
            for each in places:
                counts[name, each] += 1 / len(places)
    return counts


def plot_confusions(counts: Mapping[tuple[str, str], float], ax: Axes) -> Axes:
    """A square a pair: its shade is the part of a row, the number that of cases."""
    rows = [name for name in HIDDEN if any(hidden == name for hidden, _ in counts)]
    told = {named for _, named in counts} | {name for name in rows if name in NAMED} | ALWAYS
    columns = [name for name in NAMED if name in told]
    table = np.array([[counts.get((row, column), 0.0) for column in columns] for row in rows])
    parts = table / np.maximum(table.sum(axis=1, keepdims=True), 1e-12)
    ax.imshow(parts, cmap="Blues", vmin=0.0, vmax=1.0)
    for i, j in zip(*np.nonzero(table), strict=True):
        dark = parts[i, j] > 0.5
        count = f"{table[i, j]:{'.2g' if table[i, j] < 10.0 else '.0f'}}"
        ax.text(j, i, count, ha="center", va="center", color="w" if dark else "k")
    ax.set_xticks(range(len(columns)), columns, rotation=90)
    ax.set_yticks(range(len(rows)), rows)
    ax.set_xlabel("named")
    ax.set_ylabel("hidden")
    ax.set_xticks(np.arange(len(columns)) - 0.5, minor=True)
    ax.set_yticks(np.arange(len(rows)) - 0.5, minor=True)
    ax.grid(which="minor", color="0.85", linewidth=0.5)
    ax.tick_params(which="both", length=0)
    return ax


def write_confusion(tier: str, cases: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """The path of the picture written."""
    counts = confusions(cases)
    rows = len({hidden for hidden, _ in counts})
    columns = len({told for _, told in counts} | ALWAYS)
    figure = Figure(figsize=(3.2 + 0.34 * columns, 3.4 + 0.34 * rows), layout="constrained")
    ax = plot_confusions(counts, figure.add_subplot())
    ax.set_title(f"{tier}, {len(cases)} cases", fontsize="medium")
    write_picture(path, figure)
    return path
