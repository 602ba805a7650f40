"""The swing-up in MuJoCo from many seeds, beside the same seeds of the analytic cart-pole.

python runs/mujoco_swingup/run.py                      # seeds 28000:28020
python runs/mujoco_swingup/run.py --seeds 28000:28002  # a first look, a minute

Results are kept in results/default/, a file a seed; the same command goes on where it was stopped,
and rewrites README.md between its marked lines from all results that are there.
"""

from __future__ import annotations

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
    read_summaries,
    swept,
)

from mcpilco.sweep import markdown, mean, mean_cell, rate, rate_cell

HERE = Path(__file__).parent
ENV = "mcpilco/MujocoCartPoleSwingUp-v0"
PRESET = "default"
TRIALS = 4
CLAIM = 90.0
"""least success of the last trial, after 12 s [%]"""
ANALYTIC = HERE.parent / "cartpole_swingup" / "results", "default"
THESIS = (3.8, 38.5, 69.2, 88.5)
"""success on the analytic cart-pole, table 5.1 [%]"""


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "28000:28020"
    """`28000:28020` are 28000 to 28019, of those of the analytic cart-pole"""
    workers: int | None = None
    """processes at a time; by default one a core"""
    fresh: int = 100
    """fresh rollouts that each policy is judged by"""
    out: Path = HERE
    """folder of results/ and README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    seeds = parse_seeds(arguments.seeds)
    settings = preset_settings(ENV, "mcpilco", PRESET, TRIALS, arguments.fresh)
    path = arguments.out / "results" / PRESET
    summary = swept(settings, seeds, path, HERE.name, arguments.workers)
    write_readme(arguments.out)
    print(f"Tables: {arguments.out / 'README.md'}")
    return code_of(summary, seeds)


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    summaries = read_summaries(out / "results", [PRESET])
    parts = []
    if summaries[PRESET]["trials"]:
        folder, name = ANALYTIC
        analytic = read_summaries(folder, [name]).get(name, {"by_seed": {}, "trials": []})
        mujoco = summaries[PRESET]
        parts = [verdict(mujoco), comparison(mujoco, analytic), "### In MuJoCo", outcomes(mujoco)]
    parts += [costs(summaries), failures(summaries), machines(summaries)]
    fill(out / "README.md", parts, template=HERE / "README.md")


def verdict(summary: Mapping[str, Any]) -> str:
    """Whether the claim holds on the seeds that are there."""
    last = summary["trials"][-1]
    success = 100 * last["success"]["rate"]
    holds = "holds" if success >= CLAIM else "does not hold"
    return (
        f"Claim: success in at least {CLAIM:.0f} % after {last['experience_s']:g} s: **{holds}** "
        f"({success:.1f} %, {len(summary['seeds'])} seeds)."
    )


def comparison(mujoco: Mapping[str, Any], analytic: Mapping[str, Any]) -> str:
    """Success in both simulations, from the seeds that both have and from all, and the thesis's."""
    everywhere = len(analytic["by_seed"])
    seeds = [seed for seed in mujoco["by_seed"] if seed in analytic["by_seed"]]
    rows = [("analytic, thesis", *(f"{share:.1f}" for share in THESIS))]
    if everywhere:
        cells = (rate_cell(trial["success"]) for trial in analytic["trials"])
        rows.append((f"analytic, one rollout a policy, all {everywhere} seeds", *cells))
    for name, summary in {"analytic": analytic, "MuJoCo": mujoco}.items() if seeds else ():
        found = [summary["by_seed"][seed] for seed in seeds]
        once = zip(*(trials["success"] for trials in found), strict=True)
        often = zip(*(trials["p"] for trials in found), strict=True)
        rows.append((f"{name}, one rollout a policy", *(rate_cell(rate(x)) for x in once)))
        rows.append((f"{name}, p over fresh rollouts", *(mean_cell(mean(x)) for x in often)))
    header = ["after", *(f"{trial['experience_s']:g} s" for trial in mujoco["trials"])]
    return (
        "### Success after each amount of experience [%]\n\n"
        f"{markdown(header, rows)}\n"
        f"Ours: preset `{PRESET}`; where a row does not say which, the {len(seeds)} seeds that ran "
        "in both. In brackets: 95 % "
        "intervals, Wilson's for one rollout, the bootstrap over seeds for p."
    )


if __name__ == "__main__":
    sys.exit(main())
