"""What cost, dropout and kernel are worth: one change at a time, from two bases.

python runs/ablations/run.py --quick               # does it run at all? compiles the loops, too
python runs/ablations/run.py                       # all rows, seeds 20:40: about 2 CPU hours
python runs/ablations/run.py --rows base rbf --bases default --seeds 20:30

Results are kept in results/<base>/<row>/, a file a seed; the same command, from the same folder,
goes on where it was stopped, and rewrites README.md between its marked lines from all results that
are there.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import tyro

sys.path.append(str(Path(__file__).parents[1]))  # the settings and tables of runs/recipe

from harness import broken_off, fill, folder, hasty, machines, parse_seeds, read_summaries, swept
from recipe.run import DEFAULT, differences, dropping, searching, table

from mcpilco.config import CART_POLE, Config
from mcpilco.sweep import Settings

HERE = Path(__file__).parent
TRIALS, FRESH = 4, 100

BASES = {"default": DEFAULT, "one-start": searching(restarts=(0,))}
"""the preset default; the same without further starts, whose failures nothing mends"""


def kernel(name: Literal["rbf", "mpk"]) -> Callable[[Config], Config]:
    """A change of the GPs' kernel."""
    return lambda base: replace(base, model=replace(base.model, kernel=name))


def dropout(base: Config) -> Config:
    """Bases of the policy are left out at random, ever fewer, as in the later paper."""
    return replace(
        base, search=replace(base.search, phases=dropping(0.25, 0.125, 0.0).search.phases)
    )


@dataclass(frozen=True)
class Row:
    """One change."""

    change: Callable[[Config], Config] = lambda base: base
    """of the agent's numbers"""
    task: str | None = None
    """file with another cost"""


ROWS: Mapping[str, Row] = {
    "base": Row(),
    "tip-cost": Row(task="tip_cost.py"),
    "later-cost": Row(task="later_cost.py"),
    "dropout": Row(dropout),
    "rbf": Row(kernel("rbf")),
    "mpk": Row(kernel("mpk")),
}


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "20:40"
    """`20:40` are 20 to 39; no number of the bases was chosen on these"""
    rows: tuple[Literal[*ROWS], ...] = tuple(ROWS)
    """which of them"""
    bases: tuple[Literal[*BASES], ...] = tuple(BASES)
    """what is changed"""
    workers: int | None = None
    """processes at a time; by default one a core"""
    quick: bool = False
    """one seed, one trial, a search that learns nothing; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    out = folder(HERE, arguments.out, arguments.quick)
    failed = False
    for name in arguments.rows:
        for base in arguments.bases:
            failed |= bool(run(base, name, arguments, out)["failed"])
        write_readme(out)  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return int(failed)


def run(base: str, name: str, arguments: Arguments, out: Path) -> dict[str, Any]:
    """Train the seeds of a row that are missing; its summary."""
    row, seeds = ROWS[name], parse_seeds(arguments.seeds)
    config, trials, fresh = row.change(BASES[base]), TRIALS, FRESH
    if arguments.quick:
        seeds, config, trials, fresh = seeds[:1], hasty(config), 1, 5
    task = None if row.task is None else os.path.relpath(HERE / row.task)
    settings = Settings(f"envs:{CART_POLE}", {}, f"{base}-{name}", config, trials, fresh, task)
    print(f"{base}, {name}, {len(seeds)} seeds of {trials} trials:", flush=True)
    path = out / "results" / base / name
    return swept(settings, seeds, path, HERE.name, arguments.workers)


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    parts: list[str] = []
    everywhere = {}
    for base in BASES:
        results = out / "results" / base
        summaries = read_summaries(results, ROWS)
        everywhere |= {f"{base}/{name}": summary for name, summary in summaries.items()}
        told = {name: summary for name, summary in summaries.items() if summary["trials"]}
        if told:
            parts += [f"### Changes of `{base}`", table(told, results), differences(told, "base")]
    broken = broken_off(everywhere)
    parts += ["### Seeds that broke off\n\n" + "\n".join(broken)] if broken else []
    parts += [machines(everywhere)] if everywhere else ["Not measured yet."]
    fill(out / "README.md", parts, template=HERE / "README.md")


if __name__ == "__main__":
    sys.exit(main())
