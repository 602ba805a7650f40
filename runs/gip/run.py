"""Inverse dynamics of a SCARA and of an arm with six hinges, by six estimators.

python runs/gip/run.py --quick       # does it run at all? To runs/out
python runs/gip/run.py               # all: about an hour of one core
python runs/gip/run.py --recorded LEARN.csv OTHER.csv   # two recordings of a real arm like a UR10

Results are kept in results/<experiment>/, a file a seed; the same command goes on where it was
stopped, and rewrites the pictures, and README.md between its marked lines, from all that is there.

Reference: thesis section 3.4, figures 3.2 to 3.4.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

sys.path.insert(0, str(Path(__file__).parent.parent))
from gip import pages
from gip.experiments import EXPERIMENTS, QUICK, Sizes, recorded

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import folder, keep, kept, once, use_one_thread

from mcpilco.sweep import machine

HERE = Path(__file__).parent
SEEDS = {"scara": 20, "ur10": 3, "efficiency": 3, "ur10-efficiency": 3, "unexplained": 20}
"""trials of each experiment"""
RECORDED = (500, 1000, 2000)
"""samples to learn from, of a real arm's"""


@dataclass(frozen=True)
class Arguments:
    """Fit all estimators in all experiments, and write tables and pictures."""

    only: tuple[str, ...] = tuple(SEEDS)
    """experiments to run"""
    trials: int | None = None
    """at most so many of each"""
    recorded: tuple[Path, Path] | None = None
    """two recordings of a real arm with the joints of a UR10, to learn from and to test on"""
    quick: bool = False
    """one seed of few samples, without the network; all goes to runs/out"""
    out: Path | None = None
    """folder of results/, pictures and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    out = folder(HERE, arguments.out, arguments.quick)
    sizes = QUICK if arguments.quick else Sizes()
    if arguments.recorded is not None:
        found = recorded(*arguments.recorded, RECORDED) | {"machine": machine()}
        keep(out / "results" / "recorded" / "0000.json", found, HERE.name)
    for experiment in arguments.only:
        most = 1 if arguments.quick else arguments.trials or SEEDS[experiment]
        for seed in range(min(most, SEEDS[experiment])):
            path = out / "results" / experiment / f"{seed:04d}.json"
            if once(path, HERE.name, EXPERIMENTS[experiment], seed, sizes):
                print(f"{experiment}, seed {seed}", flush=True)
        pages.write(out, gathered(out), template=HERE / "README.md")  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return 0


def gathered(out: Path) -> dict[str, list[dict[str, Any]]]:
    """The trials of each experiment that are there."""
    found = {name: kept(out / "results" / name) for name in (*SEEDS, "recorded")}
    return {name: trials for name, trials in found.items() if trials}


if __name__ == "__main__":
    sys.exit(main())
