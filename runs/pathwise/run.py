"""The cart-pole swing-up with changes drawn in each step, and with functions drawn beforehand.

python runs/pathwise/run.py                          # step and path, seeds 0:10, 4 trials each
python runs/pathwise/run.py --settings step-eager    # step in plain torch, as path: for the time
python runs/pathwise/run.py --quick                  # seconds: does it run at all?

Results are kept in results/<setting>/, a file a seed; the same command goes on where it was
stopped, and rewrites README.md between its markers from all results that are there.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from mcpilco.cli.sweep import parse_seeds, progress
from mcpilco.config import PRESETS, Config, ModelConfig, PolicyConfig, SearchConfig

HERE = Path(__file__).parent
ENV = "envs:mcpilco/CartPoleSwingUp-v0"
BEGIN, END = "<!-- results: written by run.py -->", "<!-- end of results -->"
EXPERIENCE = (3, 6, 9, 12)
"""[s]"""
TRIALS, FRESH = 4, 100

DEFAULT = PRESETS["default"].config
SETTINGS = {
    "step": DEFAULT,
    "path": dataclasses.replace(DEFAULT, model=ModelConfig(sampling="path"), engine="eager"),
    "step-eager": dataclasses.replace(DEFAULT, engine="eager"),
}
"""the preset default, but for what is compared"""


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "0:10"
    """`0:10` are 0 to 9"""
    settings: tuple[Literal["step", "path", "step-eager"], ...] = ("step", "path")
    """which of them"""
    workers: int | None = None
    """processes at a time; by default one a core"""
    quick: bool = False
    """one seed, one trial, a search that learns nothing; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    out = arguments.out or (Path("runs/out/pathwise") if arguments.quick else HERE)
    summaries = [run(name, arguments, out) for name in arguments.settings]
    write_readme(out)
    print(f"Tables: {out / 'README.md'}")
    return 1 if any(summary["failed"] for summary in summaries) else 0


def run(name: str, arguments: Arguments, out: Path) -> dict[str, Any]:
    """Train the seeds of a setting that are missing; its summary."""
    from mcpilco.sweep import LocalEngine, Settings, SweepFolder, sweep

    config = SETTINGS[name]
    settings = Settings(ENV, {}, name, config, TRIALS, FRESH)
    if arguments.quick:
        settings = Settings(ENV, {}, name, hasty(config), trials=1, fresh=5)
    seeds = parse_seeds("0:1" if arguments.quick else arguments.seeds)
    path = out / "results" / name
    done = SweepFolder(path, settings).results().keys() & set(seeds)
    print(f"Setting {name}, {len(seeds)} seeds of {settings.trials} trials:", flush=True)
    with progress(len(seeds), len(done), quiet=False) as on_result:
        return sweep(settings, seeds, path, LocalEngine(arguments.workers), on_result)


def hasty(config: Config) -> Config:
    """The configuration with a search that takes no time, and finds nothing."""
    search = SearchConfig(particles=8, steps=(5,), restarts=(0,), evaluation_particles=8)
    return dataclasses.replace(config, policy=PolicyConfig(bases=10), search=search)


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables into README.md, between its markers; all else in it stays."""
    from mcpilco.archive import write_bytes

    page = out / "README.md"
    if not page.exists():
        page.write_bytes((HERE / "README.md").read_bytes())
    text = page.read_text(encoding="utf-8")
    if text.count(BEGIN) != 1 or text.count(END) != 1 or text.index(BEGIN) > text.index(END):
        raise SystemExit(f"{page} must hold the lines {BEGIN} and {END}, once each, in this order.")
    results = "\n\n".join(part.strip() for part in tables(read_summaries(out)))
    head, tail = text.split(BEGIN)[0], text.split(END)[1]
    write_bytes(page, f"{head}{BEGIN}\n\n{results}\n\n{END}{tail}".encode())


def read_summaries(out: Path) -> dict[str, dict[str, Any]]:
    """The summary of each setting that has results."""
    paths = {name: out / "results" / name / "summary.json" for name in SETTINGS}
    found = {
        name: json.loads(path.read_text(encoding="utf-8"))
        for name, path in paths.items()
        if path.exists()
    }
    return {name: summary for name, summary in found.items() if summary["trials"]}


def tables(summaries: Mapping[str, Any]) -> list[str]:
    """What is known by now."""
    from mcpilco.sweep.summary import mean_cell, rate_cell, spread_cell

    if not summaries:
        return ["Not measured yet."]
    return [
        "### Success after each amount of experience [%]",
        table(summaries, {"one rollout": lambda trial: rate_cell(trial["success"])}),
        "### p: mean success over fresh rollouts of each policy [%]",
        table(summaries, {"p": lambda trial: mean_cell(trial["p"])}),
        difference(summaries),
        "### Predicted cost, and the cost of the test rollout",
        table(
            summaries,
            {
                "predicted": lambda trial: spread_cell(trial["predicted_cost"], 2),
                "real": lambda trial: spread_cell(trial["real_cost"], 2),
            },
        ),
        "### A whole training: median (quartiles)",
        costs(summaries),
        "In brackets: 95 % intervals, Wilson's for one rollout, the bootstrap over seeds for p; "
        "quartiles for costs and times.",
        machines(summaries),
    ]


def table(summaries: Mapping[str, Any], rows: Mapping[str, Callable[[Any], str]]) -> str:
    """A row for each setting and kind of cell, a column for each amount of experience."""
    from mcpilco.sweep.summary import markdown

    lines = []
    for name, summary in summaries.items():
        by_experience = {round(trial["experience_s"]): trial for trial in summary["trials"]}
        for what, cell in rows.items():
            cells = (cell(by_experience[s]) if s in by_experience else "" for s in EXPERIENCE)
            lines.append((f"`{name}`, {what}, {len(summary['seeds'])} seeds", *cells))
    return markdown(("after", *(f"{seconds} s" for seconds in EXPERIENCE)), lines)


def difference(summaries: Mapping[str, Any]) -> str:
    """How much more often the policies of path succeed, seed by seed."""
    from mcpilco.sweep.summary import mean, mean_cell

    if not {"step", "path"} <= summaries.keys():
        return "The difference of p needs results of step and of path."
    step, path = (summaries[name]["by_seed"] for name in ("step", "path"))
    common = sorted(step.keys() & path.keys(), key=int)
    pairs = [zip(path[seed]["p"], step[seed]["p"], strict=False) for seed in common]
    by_trial = zip(*([p - q for p, q in pair] for pair in pairs), strict=False)
    cells = [mean_cell(mean(differences)) for differences in by_trial]
    return (
        f"p of path minus p of step, mean over the {len(common)} seeds that both have [%], after "
        f"{', '.join(f'{s} s' for s in EXPERIENCE[: len(cells)])}: {'; '.join(cells)}."
    )


def costs(summaries: Mapping[str, Any]) -> str:
    """What a training takes."""
    from mcpilco.sweep.summary import markdown, spread_cell

    rows = [
        (
            f"`{name}`",
            SETTINGS[name].engine,
            str(len(summary["trials"])),
            spread_cell(summary["run"]["cpu_s"], 1),
            spread_cell(summary["run"]["wall_s"], 1),
            spread_cell(summary["run"]["policy_steps"], 0),
            spread_cell(summary["run"]["starts"], 0),
        )
        for name, summary in summaries.items()
    ]
    header = ("setting", "engine", "trials", "CPU [s]", "wall [s]", "policy steps", "starts")
    return markdown(header, rows)


def machines(summaries: Mapping[str, Any]) -> str:
    """Where the seeds ran, and with which versions; and which seeds broke off."""
    lines = []
    for name, summary in summaries.items():
        for machine in summary["machines"]:
            versions = ", ".join(f"{part} {value}" for part, value in machine["versions"].items())
            lines.append(f"- `{name}`: {machine['cpu']}, {machine['cores']} cores; {versions}")
        lines += [
            f"- `{name}`, seed {seed} broke off: {why}" for seed, why in summary["failed"].items()
        ]
    return "### Machine\n\n" + "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
