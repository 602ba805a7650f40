"""What a model learned from 15 s saves SAC: success and return against steps of the env.

python runs/warm_start/run.py                # seeds 0 to 2, all rows: some minutes
python runs/warm_start/run.py --seeds 3:10   # more of them
python runs/warm_start/run.py --rows scratch

Results are kept in results/, a file a row and seed; the same command goes on where it was stopped,
and rewrites README.md between its marked lines from all results that are there.
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import fill, once, parse_seeds, use_one_thread

import envs  # noqa: F401  registers the cart-pole
from baselines.evaluate import Judge, learning_curve
from baselines.sb3 import WarmStart, make_learner, warm_start
from mcpilco import MCPILCO
from mcpilco.data import Stopwatch
from mcpilco.logbook import read_json, versions
from mcpilco.sweep import machine, markdown

HERE = Path(__file__).parent
ENV = "mcpilco/CartPoleSwingUp-v0"
EPISODES = 100
"""that a policy is judged by"""
SOLVED = 0.9
"""least success rate of a policy that solves the task"""
AMOUNTS = (0, 300, 600, 900, 1200, 1800, 2400, 3000, 3600, 4800, 6000, 9000, 12000)
"""steps of the env, after each of which the policy is judged"""


@dataclass(frozen=True)
class Row:
    """How SAC begins, and how long it is watched."""

    begin: WarmStart | None
    steps: int

    @property
    def amounts(self) -> list[int]:
        first = 0 if self.begin else 1
        return [amount for amount in AMOUNTS[first:] if amount <= self.steps]


ROWS: Mapping[str, Row] = {
    "scratch": Row(None, 12000),
    "filled": Row(WarmStart(rounds=0), 4800),
    "warm": Row(WarmStart(), 2400),
}


@dataclass(frozen=True)
class Arguments:
    """Train and write the table."""

    seeds: str = "0:3"
    """`0:3` are 0 to 2"""
    rows: tuple[Literal["scratch", "filled", "warm"], ...] = ("scratch", "filled", "warm")
    """which of them"""
    out: Path = HERE
    """folder of results/ and README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    results = arguments.out / "results"
    for seed in parse_seeds(arguments.seeds):
        teacher = cache(lambda seed=seed: taught(seed))
        for name in arguments.rows:
            path = results / f"{name}-{seed}.json"
            if once(path, HERE.name, measured, ROWS[name], seed, teacher):
                print(path, flush=True)
                write_readme(arguments.out)
    write_readme(arguments.out)
    return 0


@dataclass(frozen=True)
class Teacher:
    """MC-PILCO after five rollouts, and what it took."""

    agent: MCPILCO
    cpu_s: float


def taught(seed: int) -> Teacher:
    """The preset `default`: 3 s of random inputs and four trials, 150 steps."""
    watch = Stopwatch()
    agent = MCPILCO("SumOfGaussians", ENV, seed=seed)
    agent.learn(agent.timesteps_of(4))
    return Teacher(agent, watch.read().cpu_s)


def measured(row: Row, seed: int, teacher: Callable[[], Teacher]) -> dict[str, Any]:
    """What becomes of SAC from one seed, as JSON."""
    agent, begun = make_learner("sac", ENV, seed=seed), {}
    with Judge(ENV, episodes=EPISODES, seed=seed) as judge:
        if row.begin is not None:
            source = teacher()
            watch = Stopwatch()
            warm_start(agent, source.agent, row.begin)
            begun = {
                "warm_start_cpu_s": watch.read().cpu_s,
                "source_cpu_s": source.cpu_s,
                "source_steps": source.agent.num_timesteps,
                "source": judge(source.agent).to_json(),
            }
        curve = [found.to_json() for found in learning_curve(agent, judge, row.amounts)]
    steps = [{"steps": n, **found} for n, found in zip(row.amounts, curve, strict=True)]
    return {"seed": seed, **begun, "curve": steps, "machine": machine(), "versions": versions()}


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    found = {name: read_row(out / "results", name) for name in ROWS}
    found = {name: seeds for name, seeds in found.items() if seeds}
    parts = [
        "### Success rate after so many steps of SAC's own [%]",
        table(found, lambda point: 100 * point["is_success"], "{:.0f}"),
        "### Return of an episode, of at most 30 [-]",
        table(found, lambda point: point["return"], "{:.1f}"),
        "Median over seeds, in brackets the lowest and the highest.",
        "### What it took",
        effort(found),
        "Machine: " + json.dumps(next(iter(found.values()))[0]["machine"]) + ", one thread.",
    ]
    fill(out / "README.md", parts, template=HERE / "README.md")


def read_row(results: Path, name: str) -> list[dict[str, Any]]:
    """The results of a row, by seed."""
    found = [read_json(path) for path in results.glob(f"{name}-*.json")]
    return sorted(found, key=lambda result: result["seed"])


def table(
    found: Mapping[str, Sequence[dict[str, Any]]],
    value: Callable[[Mapping[str, Any]], float],
    form: str,
) -> str:
    """A line an amount, a column a row of the comparison."""
    header = ["steps", *(f"`{name}`, {len(seeds)} seeds" for name, seeds in found.items())]
    lines = []
    for amount in AMOUNTS:
        cells = []
        for seeds in found.values():
            points = [p for seed in seeds for p in seed["curve"] if p["steps"] == amount]
            cells.append(spread([value(point) for point in points], form))
        if any(cells):
            lines.append((f"{amount}", *cells))
    return markdown(header, lines)


def spread(values: Sequence[float], form: str) -> str:
    """Median, and the ends of the range."""
    if not values:
        return ""
    low, high = form.format(min(values)), form.format(max(values))
    return f"{form.format(statistics.median(values))} ({low}–{high})"


def effort(found: Mapping[str, Sequence[dict[str, Any]]]) -> str:
    """Steps of the env and processor time until a policy solves the task."""
    header = ["row", f"steps until {SOLVED:.0%} succeed, by seed", "steps of MC-PILCO before"]
    header += ["CPU until then, all together [s]"]
    lines = []
    for name, seeds in found.items():
        solved = [
            next((p for p in seed["curve"] if p["is_success"] >= SOLVED), None) for seed in seeds
        ]
        steps = ", ".join("never" if point is None else str(point["steps"]) for point in solved)
        before = str(seeds[0].get("source_steps", 0))
        cpu = [
            point["cpu_s"] + seed.get("warm_start_cpu_s", 0) + seed.get("source_cpu_s", 0)
            for seed, point in zip(seeds, solved, strict=True)
            if point is not None
        ]
        lines.append((f"`{name}`", steps, before, spread(cpu, "{:.0f}")))
    return markdown(header, lines)


if __name__ == "__main__":
    sys.exit(main())
