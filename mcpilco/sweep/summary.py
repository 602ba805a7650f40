"""The summary of a sweep: rates, means and quartiles over its seeds, and their table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from mcpilco.data import title_of
from mcpilco.logbook import measures_in
from mcpilco.sweep.statistics import CONFIDENCE, mean, rate, spread

SUMMARY_LEGEND = (
    "after: experience; success: of the one test rollout, with its "
    f"{CONFIDENCE:.0%} Wilson interval; p: mean success over fresh rollouts of each policy, mean "
    f"over seeds with its {CONFIDENCE:.0%} bootstrap interval; all else: median (quartiles) over "
    "seeds; CPU: of the trial."
)
"""the meaning of the columns of `table`"""

_SUMS = ("starts", "policy_steps", "cpu_s", "wall_s")
"""numbers of a trial that add up over a training"""
_SPREADS = ("return", "fresh_return", "predicted_cost", "real_cost", *_SUMS)


def summarise(
    results: Mapping[int, Mapping[str, Any]], failures: Mapping[int, str]
) -> dict[str, Any]:
    """Statistics over the seeds of a sweep, as JSON values.

    Returns:
        `trials`: statistics of each; `run`: of whole trainings; `solved`: share of the seeds of
        which any test rollout succeeded; `by_seed`: what is told of each; `machines`: where.
    """
    seeds = list(results.values())
    return {
        "seeds": sorted(results),
        "failed": {str(seed): why for seed, why in failures.items()},
        "trials": [
            _trial(rows) for rows in zip(*(result["trials"] for result in seeds), strict=True)
        ],
        "solved": rate(_solved(result) for result in seeds),
        "run": {
            key: spread(sum(row[key] for row in result["trials"]) for result in seeds)
            for key in _SUMS
        },
        "by_seed": {str(seed): _digest(result) for seed, result in results.items()},
        "machines": _machines(seeds),
    }


def summary_table(summary: Mapping[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """The summary as a header and a row a trial; blank where the env does not report a number."""
    measures = measures_of(summary)
    titles = ("after [s]", "success [%]", "p [%]", "return", *map(title_of, measures), "CPU [s]")
    rows = [
        (
            f"{trial['experience_s']:g}",
            rate_cell(trial["success"]),
            mean_cell(trial["p"]),
            spread_cell(trial["return"], 1),
            *(spread_cell(trial.get(name), 2) for name in measures),
            spread_cell(trial["cpu_s"], 1),
        )
        for trial in summary["trials"]
    ]
    return titles, rows


def measures_of(summary: Mapping[str, Any]) -> list[str]:
    """The env's measures in a summary."""
    return measures_in(dict.fromkeys(name for trial in summary["trials"] for name in trial))


def conclusion(summary: Mapping[str, Any]) -> str:
    """A sentence on whole trainings."""
    count = len(summary["seeds"])
    cpu = spread_cell(summary["run"]["cpu_s"], 1) or "no"
    failed = ", ".join(f"seed {seed}" for seed in summary["failed"]) or "none"
    return f"Seeds: {count}; failed: {failed}; {cpu} CPU seconds a training."


def markdown(header: Sequence[str], cells: Iterable[Sequence[str]]) -> str:
    """A table."""
    lines = [header, ["---"] * len(header), *cells]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def rate_cell(found: Mapping[str, Any] | None, kind: str = "rate") -> str:
    """A rate and its interval [%], where it has one."""
    if found is None:
        return ""
    if found["low"] is None:
        return f"{100 * found[kind]:.1f}"
    return f"{100 * found[kind]:.1f} ({100 * found['low']:.0f}–{100 * found['high']:.0f})"


def mean_cell(found: Mapping[str, Any] | None) -> str:
    """A mean share and its interval [%]."""
    return rate_cell(found, "mean")


def spread_cell(found: Mapping[str, float] | None, digits: int) -> str:
    """A median and its quartiles."""
    if found is None:
        return ""
    median, q1, q3 = (f"{found[key]:.{digits}f}" for key in ("median", "q1", "q3"))
    return f"{median} ({q1}–{q3})"


def _trial(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    measures = measures_in(dict.fromkeys(name for row in rows for name in row))
    return {
        "trial": rows[0]["trial"],
        "experience_s": float(np.median([row["experience_s"] for row in rows])),
        "success": rate(row["success"] for row in rows),
        "p": mean(row["p"] for row in rows),
        **{key: spread(row.get(key) for row in rows) for key in (*_SPREADS, *measures)},
    }


def _solved(result: Mapping[str, Any]) -> bool | None:
    told = [row["success"] for row in result["trials"] if row["success"] is not None]
    return any(told) if told else None


def _digest(result: Mapping[str, Any]) -> dict[str, Any]:
    """The trials of a seed as lists, and the time of all of them."""
    digest = {key: [row[key] for row in result["trials"]] for key in ("success", "p", "return")}
    return {**digest, "cpu_s": round(sum(row["cpu_s"] for row in result["trials"]), 1)}


def _machines(seeds: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Each machine, with its versions, that a seed ran on; once."""
    found: list[dict[str, Any]] = []
    for result in seeds:
        machine = {**result["machine"], "versions": result["versions"]}
        if machine not in found:
            found.append(machine)
    return found
