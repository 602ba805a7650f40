"""Three of Gymnasium's envs, from several seeds, judged on whole episodes.

python runs/other_envs/run.py                        # all three, seeds 0:5
python runs/other_envs/run.py --only pendulum        # one of them

Results are kept in results/<name>/, a file a seed; the same command goes on where it was stopped,
and rewrites README.md between its marked lines from all results that are there.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import broken_off, costs, fill, machines, parse_seeds, read_summaries, swept

from mcpilco.config import Config, SearchConfig
from mcpilco.sweep import Settings, markdown

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Case:
    """An env, how it is learned, and when it counts as solved."""

    env: str
    """Gymnasium id"""
    limit: int
    """steps of one of its own episodes"""
    dt: float
    """sampling time [s]"""
    threshold: float
    """mean return over fresh episodes from which on it is solved [-]"""
    trials: int
    """policies"""
    config: Config
    """numbers of the agent"""
    fresh: int = 20
    """whole episodes that each policy is judged by"""
    task: Path | None = None
    """task file; None: a guess"""


CASES: Mapping[str, Case] = {
    "pendulum": Case("Pendulum-v1", 200, 0.05, -200.0, 5, Config(horizon=80), fresh=100),
    "pendulum_rewards": Case(
        "Pendulum-v1",
        200,
        0.05,
        -200.0,
        5,
        Config(horizon=80),
        fresh=100,
        task=HERE / "pendulum.toml",
    ),
    "inverted_pendulum": Case(
        "InvertedPendulum-v5",
        1000,
        0.04,
        950.0,
        3,
        Config(horizon=90, exploration=100),
        task=HERE / "balance.py",
    ),
    "inverted_double_pendulum": Case(
        "InvertedDoublePendulum-v5",
        1000,
        0.05,
        9100.0,
        7,
        Config(
            search=SearchConfig(restarts=(1, 0)), horizon=30, exploration=300, precision="float32"
        ),
        task=HERE / "double_balance.py",
    ),
}
Name = Literal["pendulum", "pendulum_rewards", "inverted_pendulum", "inverted_double_pendulum"]


@dataclass(frozen=True)
class Arguments:
    """Train from several seeds and write the table."""

    seeds: str = "0:5"
    """`0:5` are 0 to 4"""
    only: Name | None = None
    """one of the envs"""
    workers: int = 1
    """processes at a time"""
    out: Path = HERE
    """folder of results/ and README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    names = CASES if arguments.only is None else [arguments.only]
    codes = [train(CASES[name], arguments.out / "results" / name, arguments) for name in names]
    write_readme(arguments.out)
    print(f"Tables: {arguments.out / 'README.md'}")
    return max(codes)


def train(case: Case, out: Path, arguments: Arguments) -> int:
    """Train a case from the seeds that are not there yet; 1 when one of them failed."""
    settings = Settings(
        case.env,
        config=case.config,
        trials=case.trials,
        fresh=case.fresh,
        task=None if case.task is None else os.path.relpath(case.task),
        fresh_horizon=case.limit,
    )
    seeds = parse_seeds(arguments.seeds)
    summary = swept(settings, seeds, out, HERE.name, arguments.workers)
    return 1 if summary["failed"] else 0


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    summaries = read_summaries(out / "results", CASES)
    found = {name: read_seeds(out / "results" / name) for name in summaries}
    parts = [overview(found), details(found)]
    broken = "\n".join(broken_off(summaries))
    everywhere = costs(summaries), broken, machines(summaries)
    fill(out / "README.md", [*parts, *everywhere], template=HERE / "README.md")


def read_seeds(folder: Path) -> dict[int, list[dict[str, Any]]]:
    """The trials of each seed."""
    results = [json.loads(p.read_text("utf-8")) for p in sorted((folder / "seeds").glob("*.json"))]
    return {result["seed"]: result["trials"] for result in results}


def solved_at(case: Case, trials: list[dict[str, Any]]) -> int | None:
    """Steps of the env that the first policy had been learned from that solves it."""
    for trial in trials:
        if trial["fresh_return"] >= case.threshold:
            return round(trial["experience_s"] / case.dt)
    return None


def overview(found: Mapping[str, Mapping[int, list[dict[str, Any]]]]) -> str:
    rows = []
    for name, seeds in found.items():
        case = CASES[name]
        steps = [solved_at(case, trials) for trials in seeds.values()]
        solved = sorted(step for step in steps if step is not None)
        rows.append(
            (
                name,
                f"{case.threshold:g}",
                f"{len(solved)} of {len(steps)}",
                _spread(solved, "{:.0f}"),
                _spread([step / case.limit for step in solved], "{:.2f}"),
                _spread([trials[-1]["fresh_return"] for trials in seeds.values()], "{:.1f}"),
            )
        )
    header = [
        "case",
        "solved from a mean return of",
        "seeds that solved it",
        "steps learned from, until solved",
        "the same in whole episodes",
        "mean return of the last policy",
    ]
    return f"{markdown(header, rows)}\nMedian over seeds, smallest to largest in brackets."


def _spread(values: list[float], form: str) -> str:
    if not values:
        return "–"
    numbers = statistics.median(values), min(values), max(values)
    middle, low, high = (form.format(number) for number in numbers)
    return f"{middle} ({low} to {high})"


def details(found: Mapping[str, Mapping[int, list[dict[str, Any]]]]) -> str:
    """The mean return of each policy over its fresh episodes."""
    parts = []
    for name, seeds in found.items():
        count = CASES[name].trials
        header = [name, *(f"trial {i + 1}" for i in range(count))]
        rows = [
            (f"seed {seed}", *(f"{trial['fresh_return']:.1f}" for trial in trials))
            for seed, trials in seeds.items()
        ]
        parts.append(markdown(header, rows))
    return "\n".join(parts)


if __name__ == "__main__":
    sys.exit(main())
