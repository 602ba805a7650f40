"""The pendulum swing-up from many seeds, with the preset that was chosen on the cart-pole.

python runs/pendulum_swingup/run.py                  # seeds 0:30
python runs/pendulum_swingup/run.py --seeds 0:2      # a first look, some minutes

Results are kept in results/default/, a file a seed; the same command goes on where it was stopped,
and rewrites README.md between its marked lines from all results that are there.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import (
    code_of,
    costs,
    failures,
    fill,
    machines,
    outcomes,
    parse_seeds,
    preset_settings,
    swept,
)

HERE = Path(__file__).parent
ENV = "mcpilco/Pendulum-v0"
PRESET = "default"
TRIALS = 4


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "600:630"
    """`600:630` are 600 to 629"""
    workers: int | None = None
    """processes at a time; by default one a core"""
    out: Path = HERE
    """folder of results/ and README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    seeds = parse_seeds(arguments.seeds)
    settings = preset_settings(ENV, "mcpilco", PRESET, TRIALS)
    path = arguments.out / "results" / PRESET
    summary = swept(settings, seeds, path, HERE.name, arguments.workers)
    write_readme(arguments.out)
    print(f"Tables: {arguments.out / 'README.md'}")
    return code_of(summary, seeds)


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    summary = json.loads((out / "results" / PRESET / "summary.json").read_text(encoding="utf-8"))
    summaries = {PRESET: summary}
    parts = [verdict(summary), outcomes(summary)] if summary["trials"] else []
    parts += [costs(summaries), failures(summaries), machines(summaries)]
    fill(out / "README.md", parts, template=HERE / "README.md")


def verdict(summary: Mapping[str, Any]) -> str:
    """How many seeds solved it."""
    seeds = summary["by_seed"].values()
    once, last = (sum(pick(found["success"]) for found in seeds) for pick in (any, lambda x: x[-1]))
    return (
        "Seeds that swung the pendulum up and held it: in the test rollout of at least one trial "
        f"{once} of {len(seeds)}, in that of the last trial {last} of {len(seeds)}."
    )


if __name__ == "__main__":
    sys.exit(main())
