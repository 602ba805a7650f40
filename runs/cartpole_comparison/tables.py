"""The tables of the comparison."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cartpole_swingup.run import cells, spreads, table

from mcpilco.logbook import read_json
from mcpilco.show import estimate_cell, solved_table
from mcpilco.sweep import (
    Run,
    all_amounts,
    estimate,
    markdown,
    mean_cell,
    measure_of,
    rate_cell,
    same_amount,
    spread,
    spread_cell,
)

WORKS = 0.9
"""share of fresh rollouts in which a policy that works succeeds, at least [-]"""
AMOUNTS = {12: "12 s", 60: "1 min", 600: "10 min", 3600: "1 h"}
"""experience that has a column [s]"""


def thesis_tables(summaries: Mapping[str, Any], published: bool) -> Sequence[str]:
    """Tables 5.1 to 5.3 of what learns by trials, the thesis's rows first.

    Args:
        summaries: of sweeps, by row.
        published: whether the thesis has figures for this system.
    """
    if not summaries:
        return []
    success = {}
    for name, summary in summaries.items():
        count = len(summary["seeds"])
        ways = {
            f"one rollout a policy, {count} seed{'s' * (count > 1)}": ("success", rate_cell),
            "p over fresh rollouts of each policy": ("p", mean_cell),
        }
        for way, (key, shown) in ways.items():
            row = cells(summary, lambda trial, key=key, shown=shown: shown(trial[key]))
            success[f"`{name}`, {way}"] = row
    return [
        "#### Success after each amount of experience [%] (thesis table 5.1)",
        table("success", 1, success, published),
        "In brackets: 95 % intervals, Wilson's for one rollout, the bootstrap over seeds for p.",
        "#### Time within 10 degrees of upright [s] (thesis table 5.2)",
        table("time_up_s", 2, spreads(summaries, "time_up_s"), published),
        "#### Mean distance of the cart from the origin [m] (thesis table 5.3)",
        table("mean_abs_cart_m", 2, spreads(summaries, "mean_abs_cart_m"), published),
    ]


def foresight(results: Path, names: Sequence[str]) -> Sequence[str]:
    """What models say of policies that work, and what these then cost on the system.

    Args:
        results: folder of the sweeps.
        names: of the rows that predict.
    """
    cells = []
    for name in names:
        seeds = [read_json(path) for path in sorted((results / name / "seeds").glob("*.json"))]
        good = [t for seed in seeds for t in seed["trials"] if (t["p"] or 0.0) >= WORKS]
        known = [t for t in good if t["predicted_cost"] and t["real_cost"]]
        if known:
            ratio = [trial["real_cost"] / trial["predicted_cost"] for trial in known]
            columns = ([t[key] for t in known] for key in ("predicted_cost", "real_cost"))
            told = [spread_cell(spread(values), 1) for values in columns]
            cells.append((f"`{name}`", str(len(known)), *told, spread_cell(spread(ratio), 2)))
    if not cells:
        return []
    header = ("row", "policies", "predicted cost [-]", "real cost [-]", "real over predicted")
    return [
        f"#### Predicted and real cost of policies whose p is at least {100 * WORKS:.0f} %",
        markdown(header, cells)
        + "\nSums over an episode, the real one of one rollout; median (quartiles) over policies.",
    ]


def experience_tables(runs: Sequence[Run]) -> Sequence[str]:
    """What all rows reach with seconds, minutes and an hour of experience."""
    time = "#### Processor time so far [s], interquartile mean over seeds (95 % interval)"
    return [*overview(runs), time, reached(runs, "cpu_s")]


def overview(runs: Sequence[Run]) -> Sequence[str]:
    """How much experience all rows need, and how often they succeed with so much."""
    success = "#### Success of fresh rollouts [%], mean over seeds (95 % bootstrap interval)"
    until = "#### Experience until the task is solved"
    return [until, solved_table(runs), success, reached(runs, "p")]


def reached(runs: Sequence[Run], key: str) -> str:
    """A table of one measure after `AMOUNTS` of experience, where it was judged."""
    measure = measure_of(key)
    rows = []
    for run in runs:
        told = []
        for amount in AMOUNTS:
            known = any(same_amount(amount, own) for own in all_amounts([run]))
            values = list(run.at(amount, key).values()) if known else []
            told.append(estimate_cell(estimate(values, measure, measure.statistics[0]), measure))
        rows.append((f"`{run.name}`", str(len(run.courses)), *told))
    return markdown(("row", "seeds", *AMOUNTS.values()), rows)
