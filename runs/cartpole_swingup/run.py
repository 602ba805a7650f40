"""The cart-pole swing-up from many seeds, beside the figures of the thesis.

python runs/cartpole_swingup/run.py                       # default, 100 seeds, and thesis, 30
python runs/cartpole_swingup/run.py --presets tro2022     # 10 seeds, 5 trials each
python runs/cartpole_swingup/run.py --quick               # seconds: does it run at all?

Results are kept in results/<preset>/, a file a seed; the same command goes on where it was stopped,
and rewrites README.md between its markers from all results that are there, and the first table in
the README of the project.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import (
    costs,
    failures,
    fill,
    folder,
    hasty,
    machines,
    parse_seeds,
    read_summaries,
    swept,
)

from mcpilco.config import PRESETS

HERE = Path(__file__).parent
COMPARISON = HERE.parent / "cartpole_comparison" / "results" / "cartpole"
ENV = "envs:mcpilco/CartPoleSwingUp-v0"
FRESH = 100

CLAIM = {3: 30.0, 6: 85.0, 9: 97.0, 12: 99.0}
"""experience [s] -> success of the preset default [%], at least"""

PUBLISHED: Mapping[str, Mapping[str, Sequence[float]]] = {
    "success": {"MC-PILCO": (3.8, 38.5, 69.2, 88.5), "PILCO": (0.0, 20.0, 63.3, 76.7)},
    "time_up_s": {"MC-PILCO": (0.13, 0.85, 1.30, 1.69), "PILCO": (0.10, 0.60, 1.10, 1.45)},
    "mean_abs_cart_m": {"MC-PILCO": (0.77, 0.57, 0.46, 0.16), "PILCO": (0.51, 0.52, 0.32, 0.19)},
}
"""thesis tables 5.1 to 5.3: after 3, 6, 9 and 12 s of experience"""
EXPERIENCE = (3, 6, 9, 12)


@dataclass(frozen=True)
class Plan:
    """How a preset is shown."""

    seeds: str
    trials: int


PLANS = {
    "default": Plan("28000:28100", 4),
    "thesis": Plan("31000:31030", 4),
    "tro2022": Plan("0:10", 5),
}
QUICK = Plan("0:2", 1)


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str | None = None
    """`0:30` are 0 to 29; by default 28000:28100, for thesis 31000:31030, for tro2022 0:10"""
    presets: tuple[Literal[*PLANS], ...] = ("default", "thesis")
    """which settings"""
    workers: int | None = None
    """processes at a time; by default one a core"""
    quick: bool = False
    """two seeds, one trial, a search that learns nothing; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    out = folder(HERE, arguments.out, arguments.quick)
    summaries = [run(preset, arguments, out) for preset in arguments.presets]
    write_readmes(out)
    print(f"Tables: {out / 'README.md'}")
    return 1 if any(summary["failed"] for summary in summaries) else 0


def run(preset: str, arguments: Arguments, out: Path) -> dict[str, Any]:
    """Train the seeds of a preset that are missing; its summary."""
    from mcpilco.sweep import Settings

    plan = QUICK if arguments.quick else PLANS[preset]
    seeds = parse_seeds(arguments.seeds or plan.seeds)
    chosen = PRESETS[preset]
    config, fresh = (hasty(chosen.config), 5) if arguments.quick else (chosen.config, FRESH)

    settings = Settings(ENV, chosen.env_kwargs, preset, config, plan.trials, fresh)
    print(f"Preset {preset}, {len(seeds)} seeds of {plan.trials} trials:", flush=True)
    return swept(settings, seeds, out / "results" / preset, HERE.name, arguments.workers)


# The tables ---------------------------------------------------------------------------------------


def write_readmes(out: Path) -> None:
    """Put the tables into README.md here, and the first of them into the README of the project."""
    names = list(PLANS)
    summaries = read_summaries(out / "results", names)
    setting = thesis_setting(summaries)
    parts = [verdict(summaries), *setting, *later_setting(summaries)]
    parts += [costs(summaries), failures(summaries), machines(summaries)]
    fill(out / "README.md", parts, template=HERE / "README.md")
    if out == HERE:
        fill(HERE.parents[1] / "README.md", overview(out / "results"))


def overview(results: Path) -> list[str]:
    """The table of success in short: one rollout a policy, beside PILCO's of the comparison."""
    ours = read_summaries(results, ("default", "thesis"))
    theirs = read_summaries(COMPARISON, ("pilco", "pilco-restarts"))
    settings = {
        "MC-PILCO here, preset `default`": ours.get("default"),
        "MC-PILCO here, preset `thesis`": ours.get("thesis"),
        "PILCO here": theirs.get("pilco"),
        "PILCO here, with the restarts of `default`": theirs.get("pilco-restarts"),
    }
    rows = {
        f"{name}, {len(summary['seeds'])} seeds": cells(summary, _succeeded)
        for name, summary in settings.items()
        if summary
    }
    legend = (
        "One rollout a policy, in brackets 95 % intervals (Wilson). The preset `thesis` is the "
        "setting of the doctoral thesis that the first rows are of, `default` is ours; no number "
        "was chosen on the seeds of `default`, which were run once."
    )
    return [table("success", 1, rows), legend]


def _succeeded(trial: Mapping[str, Any]) -> str:
    from mcpilco.sweep import rate_cell

    return rate_cell(trial["success"])


def at(summary: Mapping[str, Any], experience: float) -> dict[str, Any] | None:
    """The trial learned from so much experience [s]."""
    trials = (trial for trial in summary["trials"] if round(trial["experience_s"]) == experience)
    return next(trials, None)


def verdict(summaries: Mapping[str, Any]) -> str:
    """Whether the claim holds on the seeds that are there."""
    claim = ", ".join(f"{share:.0f} % after {seconds} s" for seconds, share in CLAIM.items())
    claim = f"Claim: on seeds run once the preset `default` succeeds in at least {claim}"
    trials = {seconds: at(summaries.get("default", {"trials": []}), seconds) for seconds in CLAIM}
    if any(trial is None for trial in trials.values()):
        return f"{claim}: **not measured yet**."
    rates = {seconds: 100 * trial["success"]["rate"] for seconds, trial in trials.items()}
    holds = all(rates[seconds] >= share for seconds, share in CLAIM.items())
    measured = ", ".join(f"{measured:.1f} %" for measured in rates.values())
    count = len(summaries["default"]["seeds"])
    return f"{claim}: **{'holds' if holds else 'does not hold'}** ({measured}, {count} seeds)."


def thesis_setting(summaries: Mapping[str, Any]) -> list[str]:
    """Tables 5.1 to 5.3, the thesis's rows first."""
    shown = (name for name in ("default", "thesis") if name in summaries)
    ours = {name: summaries[name] for name in shown if summaries[name]["trials"]}
    if not ours:
        return []
    return [
        "### Success after each amount of experience [%] (thesis table 5.1)",
        table("success", 1, success_rows(ours)),
        "In brackets: 95 % intervals, Wilson's for one rollout, the bootstrap over seeds for p.",
        "### Time within 10 degrees of upright [s] (thesis table 5.2)",
        table("time_up_s", 2, spreads(ours, "time_up_s")),
        "### Mean distance of the cart from the origin [m] (thesis table 5.3)",
        table("mean_abs_cart_m", 2, spreads(ours, "mean_abs_cart_m")),
    ]


def success_rows(ours: Mapping[str, Any]) -> dict[str, list[str]]:
    """Success of one rollout and of many, for each setting."""
    from mcpilco.sweep import mean_cell

    success = {}
    for name, summary in ours.items():
        count = len(summary["seeds"])
        success[f"`{name}`, one rollout a policy, {count} seeds"] = cells(summary, _succeeded)
        success[f"`{name}`, p over fresh rollouts of each policy"] = cells(
            summary, lambda trial: mean_cell(trial["p"])
        )
    return success


def spreads(summaries: Mapping[str, Any], key: str) -> dict[str, list[str]]:
    """Two rows a preset: the mean, as the thesis has it, and what tells more."""
    from mcpilco.sweep import spread_cell

    rows = {}
    for name, summary in summaries.items():
        rows[f"`{name}`, mean ± std"] = cells(
            summary, lambda trial: f"{trial[key]['mean']:.2f} ± {trial[key]['std']:.2f}"
        )
        rows[f"`{name}`, median (quartiles)"] = cells(
            summary, lambda trial: spread_cell(trial[key], 2)
        )
    return rows


def cells(summary: Mapping[str, Any], cell: Any) -> list[str]:
    """A cell for each amount of experience; blank where there is no such trial."""
    trials = (at(summary, seconds) for seconds in EXPERIENCE)
    return ["" if trial is None else cell(trial) for trial in trials]


def table(key: str, digits: int, rows: Mapping[str, Sequence[str]], published: bool = True) -> str:
    """The thesis's rows, where it has any, and ours."""
    from mcpilco.sweep import markdown

    theirs = [
        (f"{name}, thesis", *(f"{value:.{digits}f}" for value in values))
        for name, values in (PUBLISHED[key].items() if published else ())
    ]
    header = ["after", *(f"{seconds} s" for seconds in EXPERIENCE)]
    return markdown(header, theirs + [(name, *values) for name, values in rows.items()])


def later_setting(summaries: Mapping[str, Any]) -> list[str]:
    """A row a seed of the preset tro2022: when it is solved."""
    from mcpilco.sweep import markdown

    summary = summaries.get("tro2022")
    if summary is None or not summary["trials"]:
        return []
    by_seed = summary["by_seed"]
    rows = []
    for seed, found in by_seed.items():
        first = next((k for k, success in enumerate(found["success"], 1) if success), None)
        words = " ".join("yes" if success else "no" for success in found["success"])
        shares = " ".join("" if p is None else f"{p:.2f}" for p in found["p"])
        rows.append((seed, str(first or "none"), words, shares, f"{found['cpu_s']:.0f}"))
    header = ("seed", "solved in trial", "success by trial", "p by trial", "CPU [s]")
    count = max(len(found["success"]) for found in by_seed.values())
    solved = sum(any(found["success"]) for found in by_seed.values())
    return [
        "### The authors' later setting: preset `tro2022`",
        markdown(header, rows),
        f"Solved within {count} trial{'s' * (count > 1)}, that is, a test rollout succeeds: "
        f"{solved} of {len(by_seed)} seeds.",
    ]


if __name__ == "__main__":
    sys.exit(main())
