"""The cart-pole whose positions alone are measured, with noise: is the estimator worth modelling?

python runs/partial_state/run.py                  # seeds 27300:27310, 5 trials each
python runs/partial_state/run.py --quick          # does it run at all? compiles the loops, too
python runs/partial_state/run.py --settings modelled --seeds 0:2

Results are kept in results/<setting>/, a file a seed; the same command goes on where it was
stopped, and rewrites README.md between its marked lines from all results that are there.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import (
    broken_off,
    costs,
    fill,
    folder,
    hasty,
    machines,
    parse_seeds,
    read_summaries,
    swept,
)

from mcpilco.config import PRESETS, EstimatorConfig
from mcpilco.sweep import Settings, markdown, mean_cell, rate_cell, spread_cell

HERE = Path(__file__).parent
POSITIONS, MEASURED = "CartPoleSwingUpPositions", "CartPoleSwingUp"
TRIALS, FRESH = 5, 100
DEFAULT = PRESETS["default"].config

SETTINGS = {
    "modelled": (POSITIONS, DEFAULT),
    "not-refined": (POSITIONS, replace(DEFAULT, estimator=EstimatorConfig(refinements=0))),
    "not-modelled": (POSITIONS, replace(DEFAULT, estimator=EstimatorConfig(modelled=False))),
    "differences": (POSITIONS, replace(DEFAULT, estimator=EstimatorConfig(kind="differences"))),
    "all-measured": (MEASURED, DEFAULT),
}
"""the preset default; without smoothing by the model; its estimator in the loop but not in the
rollouts; another estimator; and where there is nothing to estimate"""


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "27300:27310"
    """`27300:27310` are 27300 to 27309"""
    settings: tuple[Literal[*SETTINGS], ...] = tuple(SETTINGS)
    """which of them"""
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
    for name in arguments.settings:
        failed |= bool(run(name, arguments, out)["failed"])
        write_readme(out)  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return int(failed)


def run(name: str, arguments: Arguments, out: Path) -> dict[str, Any]:
    """Train the seeds of a setting that are missing; its summary."""
    seeds, (system, config) = parse_seeds(arguments.seeds), SETTINGS[name]
    settings = Settings(f"envs:mcpilco/{system}-v0", {}, name, config, TRIALS, FRESH)
    if arguments.quick:
        seeds = seeds[:1]
        settings = replace(settings, config=hasty(config), trials=1, fresh=5)
    print(f"{name}, {len(seeds)} seeds of {settings.trials} trials:", flush=True)
    return swept(settings, seeds, out / "results" / name, HERE.name, arguments.workers)


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    summaries = read_summaries(out / "results", SETTINGS)
    told = {name: summary for name, summary in summaries.items() if summary["trials"]}
    parts = [success(told), policies(told), costs(told), machines(summaries)] if told else []
    broken = broken_off(summaries)
    parts += ["### Seeds that broke off\n\n" + "\n".join(broken)] if broken else []
    fill(out / "README.md", parts or ["Not measured yet."], template=HERE / "README.md")


def success(summaries: Mapping[str, Any]) -> str:
    """How often each setting succeeds after so much experience."""
    after = max((summary["trials"] for summary in summaries.values()), key=len)
    rows = []
    for name, summary in summaries.items():
        for label, cell in (("one rollout", rate_of), ("p", p_of)):
            cells = [cell(trial) for trial in summary["trials"]]
            cells += ["–"] * (len(after) - len(cells))
            rows.append((f"`{name}`, {label}", str(len(summary["seeds"])), *cells))
    header = ("success [%]", "seeds", *(f"{trial['experience_s']:g} s" for trial in after))
    return (
        f"### Success after so much experience\n\n{markdown(header, rows)}\n"
        "One rollout: the test rollout of each policy, with Wilson's 95 % interval; p: mean over "
        "seeds of the success in 100 fresh rollouts of each policy, with the bootstrap's."
    )


def rate_of(trial: Mapping[str, Any]) -> str:
    return rate_cell(trial["success"])


def p_of(trial: Mapping[str, Any]) -> str:
    return mean_cell(trial["p"])


def policies(summaries: Mapping[str, Any]) -> str:
    """What the last policies of each setting do, and what the model had promised."""
    rows = []
    for name, summary in summaries.items():
        last = summary["trials"][-1]
        spreads = [spread_cell(last[key], 1) for key in ("predicted_cost", "real_cost")]
        spreads += [spread_cell(last["time_up_s"], 2), spread_cell(last["mean_abs_cart_m"], 2)]
        rows.append((f"`{name}`", f"{last['experience_s']:g} s", *spreads))
    header = ("last policy", "after", "predicted cost", "real cost", "time up [s]", "cart [m]")
    return (
        f"### The last policy: median (quartiles) over seeds\n\n{markdown(header, rows)}\n"
        "Costs are sums over the 30 steps; cart: mean distance from the origin."
    )


if __name__ == "__main__":
    sys.exit(main())
