"""MC-PILCO learns to swing a pendubot up, with and without its equations.

python runs/pendubot_swingup/run.py --quick            # does it run at all?
python runs/pendubot_swingup/run.py                    # both models, seeds 0:10: CPU hours
python runs/pendubot_swingup/run.py --models physics+rbf --seeds 0:2

Results are kept in results/<model>/, a file a seed, rewritten after each trial. The same command
goes on where it was stopped, and rewrites README.md between its marked lines from all results.
A seed ends with the first policy that succeeds in its test rollout and in 9 of 10 fresh ones, or
after 60 s of experience.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import fill, folder, hasty, keep, kept, parse_seeds, places, use_one_thread

import envs
from mcpilco import MCPILCO
from mcpilco.config import Config, ModelConfig, Phase, PolicyConfig, SearchConfig
from mcpilco.logbook import read_json, versions
from mcpilco.sweep import FreshEpisodes, machine, markdown, rate, rate_cell, spread, spread_cell

HERE = Path(__file__).parent
ENV = "mcpilco/Pendubot-v0"
TRIALS = 24
"""of 2.5 s each; the last policy is learned from 60 s, 2.5 s of random inputs among them"""
FRESH, SOLVED = 50, 0.9
"""episodes that a policy is judged by, and the share of them that ends a seed"""
WRONG = 0.2
"""a nominal mass is wrong by up to this part of it, in either direction"""
MASSES = ("upper_mass", "lower_mass")

CONFIG = Config(
    policy=PolicyConfig(lengthscale=8.0, squash=1.0, weight=0.3),
    search=SearchConfig(
        particles=48,
        evaluation_particles=96,
        restarts=(1,),
        rates=(1.0, 1.0, 0.7, 0.5, 0.3),
        failing=0.02,
        phases=(Phase(0.04, until=0.5), Phase(0.02, until=0.75), Phase(0.008)),
        widening=2.0,
        correlations=(0.0,),
    ),
    precision="float32",
)
"""what differs from the preset `default`, and why, is told in README.md"""
MODELS: Mapping[str, ModelConfig] = {
    "rbf+mpk": ModelConfig(),
    "physics+rbf": ModelConfig(kernel="rbf", mean="physics"),
}


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "0:10"
    """`0:10` are 0 to 9"""
    models: tuple[Literal[*MODELS], ...] = ("physics+rbf", "rbf+mpk")
    """which of them"""
    quick: bool = False
    """one seed, two trials, a search that learns nothing; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    out = folder(HERE, arguments.out, arguments.quick)
    seeds, trials = parse_seeds(arguments.seeds), TRIALS
    if arguments.quick:
        seeds, trials = seeds[:1], 2
    for seed in seeds:
        for name in arguments.models:
            path = out / "results" / name / f"{seed:04d}.json"
            if not (path.exists() and read_json(path)["over"]):
                config = hasty(config_of(name, seed)) if arguments.quick else config_of(name, seed)
                for result in learned(config, seed, trials):
                    keep(path, result, HERE.name)
                    write_readme(out)
                print(f"{name}, seed {seed}: {verdict(result)}", flush=True)
    write_readme(out)
    return 0


def config_of(name: str, seed: int) -> Config:
    """The numbers of a seed; physics know masses that are wrong."""
    model = MODELS[name]
    if model.mean == "physics":
        wrong = {"format": 1, "plant": ENV, "parameters": wrong_masses(seed), "effects": []}
        model = replace(model, plant=wrong)
    return replace(CONFIG, model=model)


def wrong_masses(seed: int) -> dict[str, float]:
    """Nominal masses of a seed [kg]."""
    rng, true = np.random.default_rng([seed, 7]), envs.PLANTS[ENV]().values
    return {m: true[m] * (1.0 + float(rng.uniform(-WRONG, WRONG))) for m in MASSES}


def learned(config: Config, seed: int, trials: int) -> Iterator[dict[str, Any]]:
    """What is known of a seed after each trial, as JSON; the last one is over."""
    agent = MCPILCO("SumOfGaussians", ENV, config=config, seed=seed)
    about = {"seed": seed, "machine": machine(), "versions": versions()}
    rows: list[dict[str, Any]] = []
    with FreshEpisodes(ENV, {}, FRESH, agent.horizon) as judge:
        for trial in range(1, trials + 1):
            agent.learn(agent.timesteps_of(1))
            fresh = judge.outcomes(agent.controller, seed, trial)
            rows.append(_row(agent.results[-1], float(fresh["is_success"].mean())))
            over = trial == trials or solved(rows[-1])
            yield {**about, "over": over, "trials": rows}
            if over:
                return


def _row(result: Any, p: float) -> dict[str, Any]:
    numbers = ("experience_s", "predicted_cost", "real_cost", "starts", "cpu_s")
    told = {name: getattr(result, name) for name in numbers}
    return {
        "trial": result.trial,
        "success": bool(result.success),
        "p": p,
        **told,
        **result.outcome,
    }


def solved(row: Mapping[str, Any]) -> bool:
    """Whether a policy swings it up and holds it, again and again."""
    return row["success"] and row["p"] >= SOLVED


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    found = {name: read_results(out / "results" / name) for name in MODELS}
    found = {name: results for name, results in found.items() if results}
    everyone = [result for results in found.values() for result in results]
    parts = [table(found), "### Each seed", seeds_table(found), places(everyone, ", one thread")]
    fill(
        out / "README.md",
        parts if everyone else ["Not measured yet."],
        template=HERE / "README.md",
    )


def read_results(folder: Path) -> list[dict[str, Any]]:
    """Of the seeds that are there, unfinished ones too."""
    return kept(folder)


def table(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """Success within 60 s by model, over the seeds that are over."""
    header = ("model", "seeds", "one test rollout succeeded [%]", "solved [%]")
    header += ("experience until solved [s]", "largest p [%]", "CPU a seed [s]")
    lines = []
    for name, results in found.items():
        over = [result for result in results if result["over"]]
        if not over:
            continue
        until = [first(result, solved) for result in over]
        lines.append(
            (
                f"`{name}`",
                str(len(over)),
                rate_cell(rate(first(result, _succeeded) is not None for result in over)),
                rate_cell(rate(seconds is not None for seconds in until)),
                spread_cell(spread(s for s in until if s is not None), 1),
                spread_cell(spread(100 * best(result) for result in over), 0),
                spread_cell(spread(sum(row["cpu_s"] for row in r["trials"]) for r in over), 0),
            )
        )
    legend = (
        f"Solved: a policy succeeded in its test rollout and in at least {SOLVED:.0%} of {FRESH} "
        "fresh ones; p: success over fresh rollouts. In brackets: 95 % intervals of Wilson for "
        "shares, else quartiles beside the median."
    )
    return f"{markdown(header, lines)}\n{legend}" if lines else "No seed is over yet."


def seeds_table(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """A line a seed."""
    header = ("model", "seed", "trials", "first success after [s]", "solved after [s]")
    header += ("largest p [%]", "longest upright [s]")
    lines = [
        (
            f"`{name}`",
            f"{result['seed']}{'' if result['over'] else ' (goes on)'}",
            str(len(result["trials"])),
            *(_seconds(first(result, rule)) for rule in (_succeeded, solved)),
            f"{100 * best(result):.0f}",
            f"{max(row['time_up_s'] for row in result['trials']):.2f}",
        )
        for name, results in found.items()
        for result in results
    ]
    return markdown(header, lines)


def first(result: Mapping[str, Any], rule: Callable[[Mapping[str, Any]], bool]) -> float | None:
    """Experience that the first policy of a kind was learned from [s]; None: there is none."""
    return next((row["experience_s"] for row in result["trials"] if rule(row)), None)


def best(result: Mapping[str, Any]) -> float:
    """Share of fresh rollouts in which a seed's best policy succeeded [-]."""
    return max(row["p"] for row in result["trials"])


def verdict(result: Mapping[str, Any]) -> str:
    """How a seed ended."""
    seconds = first(result, solved)
    ending = "never solved" if seconds is None else f"solved after {seconds:.1f} s"
    return f"best p {best(result):.2f}, {ending}"


def _succeeded(row: Mapping[str, Any]) -> bool:
    return bool(row["success"])


def _seconds(value: float | None) -> str:
    return "never" if value is None else f"{value:.1f}"


if __name__ == "__main__":
    sys.exit(main())
