"""Tables and the picture of what was measured."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from harness import fill, places, write_picture
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from mcpilco.logbook import read_json
from mcpilco.sweep import markdown

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
SOLVED = 0.9
"""least success rate of a policy that solves the task"""
SIMULATED = (
    ("a", None, "MC-PILCO", "nominal"),
    ("b", None, "MC-PILCO", "corrected"),
    ("e", "nominal", "SAC", "nominal"),
    ("e", "corrected", "SAC", "corrected"),
)
"""leg and which part of it, what learned, and in which simulation"""


def write(out: Path) -> None:
    """Put picture and tables of the results that are there into README.md.

    Those of this folder go into the README of the project and into its docs as well, in short.
    """
    found = [read_json(path) for path in sorted((out / "results" / "seeds").glob("*.json"))]
    parts = ["Not measured yet."]
    if found:
        learnt = of_leg(found, "c") + of_leg(found, "d")
        write_picture(out / "crossing.png", picture(found))
        parts = [
            "![What simulations promised, what happened, and learning on the system](crossing.png)",
            "### Success on the system",
            policies(found),
            *(["### Learning on the system itself", experience(found)] if learnt else []),
            *(
                ["### Over the posterior, and at its mean", from_few(found)]
                if of_leg(found, "f")
                else []
            ),
            "### By what is hidden",
            by_kind(found),
            "### Seed by seed",
            by_seed(found),
            places(found),
        ]
    fill(out / "README.md", parts, template=HERE / "README.md")
    if found and out == HERE:
        fill(ROOT / "README.md", [story(found)], name="crossing")
        fill(ROOT / "docs" / "crossing.md", [story(found), by_kind(found)], name="crossing")


def story(found: Sequence[Mapping[str, Any]]) -> str:
    """All legs in one table."""
    rows = []
    for leg, part, algo, simulation in SIMULATED:
        if outcomes := of_leg(found, leg, part):
            name = f"in the {simulation} simulation" + (f", by {algo}" if leg == "e" else "")
            promised = 100 * np.mean([outcome["promised"] for outcome in outcomes])
            shares = [outcome["happened"] for outcome in outcomes]
            seconds = outcomes[0]["experience_s"]
            rows.append((name, len(shares), f"{promised:.0f}", *_on_system(shares), f"{seconds:g}"))
    for leg, name in (
        ("c", "on the system, from nothing"),
        ("d", "on the system, with the corrected simulation's equations"),
    ):
        if outcomes := of_leg(found, leg):
            shares, seconds = [o["p"][-1] for o in outcomes], outcomes[0]["experience_s"][-1]
            told = f"{seconds:g}" if leg == "c" else f"60 and {seconds:g}"
            rows.append((name, len(shares), "", *_on_system(shares), told))
    header = ("learned", "seeds", "promised [%]", "succeeds [%]", "solved", "seconds of the system")
    return markdown(header, [tuple(map(str, row)) for row in rows])


def _on_system(shares: Sequence[float]) -> tuple[str, str]:
    return share(shares), f"{sum(p >= SOLVED for p in shares)} of {len(shares)}"


def policies(found: Sequence[Mapping[str, Any]]) -> str:
    """What simulations promised and what happened, over seeds."""
    rows = []
    for leg, part, algo, simulation in SIMULATED:
        if outcomes := of_leg(found, leg, part):
            shares = [outcome["happened"] for outcome in outcomes]
            rows.append(
                (
                    f"{leg}: {algo} in the {simulation} simulation",
                    str(len(outcomes)),
                    share([outcome["promised"] for outcome in outcomes]),
                    share(shares),
                    f"{sum(p >= SOLVED for p in shares)} of {len(shares)}",
                    f"{statistics.median(outcome['return'] for outcome in outcomes):.1f}",
                )
            )
    header = ("trained", "seeds", "promised [%]", "on the system [%]", "solved", "return there")
    return markdown(header, rows)


def from_few(found: Sequence[Mapping[str, Any]]) -> str:
    """Legs f and g on the seeds that have both: what was promised, and what happened."""
    both = [seed for seed in found if {"f", "g"} <= set(seed["legs"])]
    rows = []
    for kind in (*sorted({seed["kind"] for seed in both}), "all"):
        ours = [seed for seed in both if kind in (seed["kind"], "all")]
        cells = [
            share([outcome[what] for outcome in of_leg(ours, leg)])
            for leg in "fg"
            for what in ("promised", "happened")
        ]
        apart = 100 * (np.mean(ends(ours, "f")) - np.mean(ends(ours, "g")))
        solving = [f"{sum(p >= SOLVED for p in ends(ours, leg))}" for leg in "fg"]
        rows.append((kind, str(len(ours)), *cells, f"{apart:+.1f}", " and ".join(solving)))
    header = (
        "hidden",
        "seeds",
        "f promised [%]",
        "f on the system [%]",
        "g promised [%]",
        "g on the system [%]",
        "f - g [points]",
        "solved by f and g",
    )
    return markdown(header, rows)


def of_leg(found: Sequence[Mapping[str, Any]], leg: str, part: str | None = None) -> list[Any]:
    there = [seed["legs"][leg] for seed in found if leg in seed["legs"]]
    return there if part is None else [outcome[part] for outcome in there]


def share(values: Sequence[float]) -> str:
    """Mean share [%], in brackets the least and the greatest."""
    return f"{100 * np.mean(values):.0f} ({100 * min(values):.0f}–{100 * max(values):.0f})"


def experience(found: Sequence[Mapping[str, Any]]) -> str:
    """Success after each amount of experience, and what a solution takes."""
    rows = []
    amounts = max((o["experience_s"] for leg in "cd" for o in of_leg(found, leg)), key=len)
    for leg, name in (("c", "c: from nothing"), ("d", "d: corrected simulation as prior mean")):
        outcomes = of_leg(found, leg)
        if outcomes:
            p = np.array([outcome["p"] for outcome in outcomes])
            unknown = [""] * (len(amounts) - p.shape[1])
            seconds = [solved(outcome) for outcome in outcomes]
            rows.append(
                (
                    name,
                    str(len(outcomes)),
                    *(share(list(column)) for column in p.T),
                    *unknown,
                    f"{statistics.median(seconds):g} ({sum(map(math.isfinite, seconds))})",
                )
            )
    header = ["model", "seeds", *(f"after {s:g} s [%]" for s in amounts)]
    return markdown([*header, "solved after [s] (seeds)"], rows)


def solved(outcome: Mapping[str, Any]) -> float:
    """Experience behind the first policy that solves the task [s]; inf where none does."""
    pairs = zip(outcome["experience_s"], outcome["p"], strict=True)
    return next((seconds for seconds, p in pairs if p >= SOLVED), math.inf)


def by_kind(found: Sequence[Mapping[str, Any]]) -> str:
    """Success on the system at the end of each leg, for each kind of what is hidden."""
    legs = [leg for leg in "abecd" if of_leg(found, leg)]
    rows = []
    found = [seed for seed in found if any(leg in seed["legs"] for leg in legs)]
    for kind in sorted({seed["kind"] for seed in found}):
        ours = [seed for seed in found if seed["kind"] == kind]
        shares = [ends(ours, leg) for leg in legs]
        rows.append((kind, str(len(ours)), *(share(these) if these else "" for these in shares)))
    names = {
        "a": "a: nominal simulation [%]",
        "b": "b: corrected simulation [%]",
        "e": "e: the same, by SAC [%]",
        "c": "c: on the system, from nothing [%]",
        "d": "d: with the corrected equations [%]",
    }
    return markdown(("hidden", "seeds", *(names[leg] for leg in legs)), rows)


def ends(found: Sequence[Mapping[str, Any]], leg: str) -> list[float]:
    """Success of the last policy of a leg; of SAC's, that of the corrected simulation."""
    outcomes = of_leg(found, leg, "corrected" if leg == "e" else None)
    return [outcome["p"][-1] if leg in "cd" else outcome["happened"] for outcome in outcomes]


def by_seed(found: Sequence[Mapping[str, Any]]) -> str:
    rows, few = [], [leg for leg in "fg" if of_leg(found, leg)]
    for seed in found:
        legs = seed["legs"]
        hidden_here = "; ".join(in_words(effect) for effect in seed["hidden"]["effects"])
        gap = legs.get("b") or legs.get("f")
        named = ("; ".join(gap["named"]) or gap["verdict"]) if gap else ""
        cells = [
            ", ".join(f"{100 * end:.0f}" for end in ends([seed], leg)) for leg in [*"abe", *few]
        ]
        cells += [f"{solved(legs[leg]):g}" if leg in legs else "" for leg in "cd"]
        rows.append((str(seed["seed"]), hidden_here, named, *cells))
    header = ("seed", "hidden", "named", *(f"{leg} [%]" for leg in [*"abe", *few]))
    header += ("c solved [s]", "d solved [s]")
    return markdown(header, rows)


def in_words(effect: Mapping[str, Any]) -> str:
    numbers = ", ".join(f"{name} = {value:g}" for name, value in effect["parameters"].items())
    return f"{effect['name']} at {effect['target']} ({numbers})"


def picture(found: Sequence[Mapping[str, Any]]) -> Figure:
    """What simulations promised beside what happened, and success over experience."""
    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    plot_promises(found, left)
    plot_learning(found, right)
    handles = [handle for ax in (left, right) for handle in ax.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize="small")
    return figure


def plot_promises(found: Sequence[Mapping[str, Any]], ax: Axes) -> Axes:
    """Success in the simulation and on the system, a line a seed; black is their mean."""
    legs = [leg for leg in "ab" if of_leg(found, leg)]
    kinds = sorted({seed["kind"] for seed in found})
    for place, leg in enumerate(legs):
        ends = np.array([2.0 * place, 2.0 * place + 1.0])
        for number, kind in enumerate(kinds):
            ours = of_leg([seed for seed in found if seed["kind"] == kind], leg)
            shift = 0.04 * (number - (len(kinds) - 1) / 2)  # equal lines lie side by side
            for at, outcome in enumerate(ours):
                label = kind if place == 0 and at == 0 else None
                ax.plot(ends + shift, _percent(outcome), ".-", color=f"C{number}", label=label)
        mean = np.mean([_percent(outcome) for outcome in of_leg(found, leg)], axis=0)
        ax.plot(ends, mean, "o-", color="black", linewidth=3, label="mean" if place == 0 else None)
    names = {"a": "nominal", "b": "corrected"}
    labels = [f"{names[leg]}\n{what}" for leg in legs for what in ("promised", "happened")]
    ax.set(ylabel="success [%]", ylim=(-4, 104), xlim=(-0.4, 2.0 * len(legs) - 0.6))
    ax.set_xticks(range(len(labels)), labels)
    ax.set_title("policies of a simulation", fontsize="medium")
    return ax


def plot_learning(found: Sequence[Mapping[str, Any]], ax: Axes) -> Axes:
    """Success over experience of the system: mean over seeds, quartiles as a band."""
    for leg, colour, name in (
        ("c", "tab:gray", "from nothing"),
        ("d", "tab:blue", "with the corrected equations"),
    ):
        outcomes = of_leg(found, leg)
        if outcomes:
            seconds = outcomes[0]["experience_s"]
            p = 100 * np.array([outcome["p"] for outcome in outcomes])
            ax.plot(seconds, p.mean(0), "o-", color=colour, label=name)
            ax.fill_between(seconds, *np.percentile(p, (25, 75), axis=0), color=colour, alpha=0.2)
            ax.set_xticks(seconds if leg == "c" else ax.get_xticks())
    ax.set(xlabel="experience of the system [s]")
    ax.set_title("learning on the system", fontsize="medium")
    return ax


def _percent(outcome: Mapping[str, Any]) -> tuple[float, float]:
    return 100 * outcome["promised"], 100 * outcome["happened"]
