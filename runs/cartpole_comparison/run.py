"""The thesis's comparison on the cart-pole: MC-PILCO and PILCO from the same seeds.

python runs/cartpole_comparison/run.py                          # 30 seeds of each: hours
python runs/cartpole_comparison/run.py --seeds 0:1              # one seed of each: minutes
python runs/cartpole_comparison/run.py --rows pilco pilco-tip   # some of them

Results are kept in results/<row>/, a file a seed; the same command goes on where it was stopped,
and rewrites README.md between its markers from all results that are there.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

sys.path.append(str(Path(__file__).parents[1]))  # the thesis's tables are those of that run

from cartpole_swingup.run import cells, spreads, table

from mcpilco.cli.sweep import Sweep
from mcpilco.sweep.page import costs, failures, fill, machines, read_summaries

HERE = Path(__file__).parent
TRIALS = 4


@dataclass(frozen=True)
class Row:
    """An agent of the table."""

    algo: str
    preset: str


ROWS: Mapping[str, Row] = {
    "mcpilco": Row("mcpilco", "default"),
    "pilco": Row("pilco", "default"),
    "pilco-tip": Row("pilco", "tip"),
}


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "0:30"
    """`0:30` are 0 to 29"""
    rows: tuple[Literal["mcpilco", "pilco", "pilco-tip"], ...] = ("mcpilco", "pilco", "pilco-tip")
    """which agents: MC-PILCO, PILCO with the thesis's cost, PILCO with its own"""
    workers: int | None = None
    """processes at a time; by default one a core"""
    out: Path = HERE
    """folder of results/ and README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    codes = []
    for name in arguments.rows:
        print(f"{name}:", flush=True)
        row, out = ROWS[name], arguments.out / "results" / name
        sweep = Sweep(
            out=out,
            seeds=arguments.seeds,
            algo=row.algo,
            preset=row.preset,
            trials=TRIALS,
            workers=arguments.workers,
        )
        codes.append(sweep())
        write_readme(arguments.out)
    print(f"Tables: {arguments.out / 'README.md'}")
    return max(codes)


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    summaries = read_summaries(out / "results", ROWS)
    parts = [*tables({name: s for name, s in summaries.items() if s["trials"]})]
    parts += [costs(summaries), failures(summaries), machines(summaries)]
    fill(out / "README.md", parts, template=HERE / "README.md")


def tables(summaries: Mapping[str, Any]) -> Sequence[str]:
    """Tables 5.1 to 5.3, the thesis's rows first."""
    from mcpilco.sweep.summary import mean_cell, rate_cell

    success = {}
    for name, summary in summaries.items():
        count = len(summary["seeds"])
        ways = {
            f"one rollout a policy, {count} seed{'s' * (count > 1)}": ("success", rate_cell),
            "p over fresh rollouts of each policy": ("p", mean_cell),
        }
        for way, (key, cell) in ways.items():
            shown = cells(summary, lambda trial, key=key, cell=cell: cell(trial[key]))
            success[f"`{name}`, {way}"] = shown

    return [
        "### Success after each amount of experience [%] (thesis table 5.1)",
        table("success", 1, success),
        "In brackets: 95 % intervals, Wilson's for one rollout, the bootstrap over seeds for p.",
        "### Time within 10 degrees of upright [s] (thesis table 5.2)",
        table("time_up_s", 2, spreads(summaries, "time_up_s")),
        "### Mean distance of the cart from the origin [m] (thesis table 5.3)",
        table("mean_abs_cart_m", 2, spreads(summaries, "mean_abs_cart_m")),
    ]


if __name__ == "__main__":
    sys.exit(main())
