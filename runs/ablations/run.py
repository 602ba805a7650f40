"""The worth of each choice of the presets `default` and `thesis`, one change at a time.

python runs/ablations/run.py --quick               # does it run at all? compiles the loops, too
python runs/ablations/run.py                       # all rows, seeds 4300:4310: two CPU hours
python runs/ablations/run.py --bases thesis --seeds 4200:4210

Results are kept in results/<base>/<row>/, a file a seed; the same command, from the same folder,
goes on where it was stopped, and rewrites README.md between its marked lines from all results that
are there.
"""

from __future__ import annotations

import math
import os
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import (
    broken_off,
    fill,
    folder,
    hasty,
    machines,
    parse_seeds,
    preset_settings,
    read_summaries,
    swept,
)

from mcpilco.config import CART_POLE, PRESETS, Config
from mcpilco.logbook import read_json
from mcpilco.sweep import Settings, markdown, mean, mean_cell, spread_cell

HERE = Path(__file__).parent
TRIALS, FRESH = 4, 100
SOLVED = 0.9
"""least p of a policy that solves the task"""
BASES = ("default", "thesis")
"""presets that are changed"""
Change = Callable[[Config], Config]
"""of the agent's numbers"""


def searching(**changes: Any) -> Change:
    """A change of the search."""
    return lambda base: replace(base, search=replace(base.search, **changes))


def modelling(**changes: Any) -> Change:
    """A change of the model."""
    return lambda base: replace(base, model=replace(base.model, **changes))


def pushing(weight: float) -> Change:
    """Another size of the first weights."""
    return lambda base: replace(base, policy=replace(base.policy, weight=weight))


def dropping(base: Config) -> Config:
    """Bases of the policy are left out at random, ever fewer, as in the later paper."""
    phases = base.search.phases
    if len(phases) == 1:
        phases = tuple(replace(phases[0], until=until) for until in (0.5, 0.75, 1.0))
    rates = zip(phases, (0.25, 0.125, 0.0), strict=True)
    phases = tuple(replace(phase, dropout=rate) for phase, rate in rates)
    return replace(base, search=replace(base.search, phases=phases))


def slower(base: Config) -> Config:
    """Half the learning rate, in all phases."""
    phases = base.search.phases
    halved = tuple(replace(phase, learning_rate=phase.learning_rate / 2) for phase in phases)
    return replace(base, search=replace(base.search, phases=halved))


def by_paths(base: Config) -> Config:
    """Changes by functions that a particle keeps over the horizon; in plain torch."""
    return replace(base, engine="eager", model=replace(base.model, sampling="path"))


@dataclass(frozen=True)
class Row:
    """One change."""

    change: Change = lambda base: base
    task: str | None = None
    """file with another cost"""
    of: tuple[str, ...] = BASES
    """the bases that it changes"""


OURS, THESIS = BASES[:1], BASES[1:]
ROWS: Mapping[str, Row] = {
    "base": Row(),
    "tip-cost": Row(task="tip_cost.py", of=OURS),
    "later-cost": Row(task="later_cost.py", of=OURS),
    "rbf": Row(modelling(kernel="rbf"), of=OURS),
    "mpk": Row(modelling(kernel="mpk"), of=OURS),
    "no-mirror": Row(modelling(mirror=0), of=OURS),
    "no-prior": Row(modelling(prior_std=None), of=OURS),
    "random-first": Row(lambda base: replace(base, excitation="random"), of=OURS),
    "double": Row(lambda base: replace(base, precision="float64"), of=OURS),
    "no-polish": Row(searching(polish=False), of=OURS),
    "no-widening": Row(searching(widening=1.0), of=OURS),
    "no-clipping": Row(searching(clip_norm=None), of=OURS),
    "small-weights": Row(pushing(5.0), of=OURS),
    "early-screening": Row(searching(screening=0.3), of=OURS),
    "one-start": Row(searching(restarts=(0,)), of=OURS),
    "uncorrelated": Row(searching(correlations=(0.0,)), of=OURS),
    "path": Row(by_paths, of=OURS),
    "dropout": Row(dropping),
    "planned-first": Row(lambda base: replace(base, excitation="planned"), of=THESIS),
    "mirror": Row(modelling(mirror=90), of=THESIS),
    "prior": Row(modelling(prior_std=2.0), of=THESIS),
    "clipping": Row(searching(clip_norm=1.0), of=THESIS),
    "widening": Row(searching(widening=3.0), of=THESIS),
    "large-weights": Row(pushing(10.0), of=THESIS),
    "half-rate": Row(slower, of=THESIS),
    "starts": Row(searching(restarts=(1, 3)), of=THESIS),
}


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "4300:4310"
    """`4300:4310` are 4300 to 4309; the rows of `thesis` are of 4200:4210"""
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
            if base in ROWS[name].of:
                failed |= bool(run(base, name, arguments, out)["failed"])
        write_readme(out)  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return int(failed)


def run(base: str, name: str, arguments: Arguments, out: Path) -> dict[str, Any]:
    """Train the seeds of a row that are missing; its summary."""
    settings, seeds = settings_of(base, name), parse_seeds(arguments.seeds)
    if arguments.quick:
        seeds = seeds[:1]
        settings = replace(settings, config=hasty(settings.config), trials=1, fresh=5)
    print(f"{base}, {name}, {len(seeds)} seeds of {settings.trials} trials:", flush=True)
    path = out / "results" / base / name
    return swept(settings, seeds, path, HERE.name, arguments.workers)


def settings_of(base: str, name: str) -> Settings:
    """The settings of a row: a preset with its change."""
    row, preset = ROWS[name], preset_settings(CART_POLE, "mcpilco", base, TRIALS, FRESH)
    task = None if row.task is None else os.path.relpath(HERE / row.task)
    config = row.change(PRESETS[base].config)
    return replace(preset, preset=f"{base}-{name}", config=config, task=task)


# The tables ---------------------------------------------------------------------------------------


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


def table(summaries: Mapping[str, Any], results: Path) -> str:
    """How often each setting succeeds, and what it costs."""
    rows = []
    for name, summary in summaries.items():
        last = {seed: found["p"][-1] for seed, found in summary["by_seed"].items()}
        worst = min(last, key=last.__getitem__)
        paths = [results / name / "seeds" / f"{seed:04d}.json" for seed in summary["seeds"]]
        seconds = [solved_seconds(read_json(path)["trials"]) for path in paths]
        rows.append(
            (
                f"`{name}`",
                str(len(last)),
                *(mean_cell(trial["p"]) for trial in summary["trials"]),
                f"{100 * last[worst]:.0f} (seed {worst})",
                spread_cell(summary["run"]["cpu_s"], 1),
                spread_cell(summary["run"]["policy_steps"], 0),
                f"{statistics.median(seconds):.1f} ({sum(map(math.isfinite, seconds))})",
            )
        )
    header = ["setting", "seeds", *(f"p after {after} [%]" for after in experience(summaries))]
    header += ["worst seed's last p [%]", "CPU [s]", "policy steps", "solved [CPU s] (seeds)"]
    return markdown(header, rows)


def solved_seconds(trials: Sequence[Mapping[str, Any]]) -> float:
    """CPU time of a seed's trials up to the first that solves the task [s]; inf where none does."""
    spent = 0.0
    for trial in trials:
        spent += trial["cpu_s"]
        if trial["p"] >= SOLVED:
            return spent
    return math.inf


def differences(summaries: Mapping[str, Any], base: str) -> str:
    """How much more often the policies of each setting succeed than those of the base."""
    if base not in summaries:
        return f"The differences of p need results of `{base}`."
    p = {name: shares(summary) for name, summary in summaries.items()}
    default = p.pop(base)
    rows = []
    for name, changed in p.items():
        common = sorted(changed.keys() & default.keys())
        if common:
            gains = np.array([changed[seed] - default[seed] for seed in common])  # (seeds, trials)
            cells = map(difference_cell, (*gains.T, gains.mean(axis=1)))
            rows.append((f"`{name}`", str(len(common)), *cells))
    if not rows:
        return ""
    columns = (*experience(summaries), "mean of all")
    return markdown((f"p minus that of `{base}` [%]", "common seeds", *columns), rows)


def shares(summary: Mapping[str, Any]) -> dict[int, np.ndarray]:
    """p of each trial, by seed."""
    return {int(seed): np.array(found["p"]) for seed, found in summary["by_seed"].items()}


def difference_cell(gains: np.ndarray) -> str:
    """A mean over seeds and its interval [%], whose ends may be negative."""
    return mean_cell(mean(gains)).replace("–", " to ")


def experience(summaries: Mapping[str, Any]) -> list[str]:
    """The recorded time that each trial learns from."""
    trials = next(iter(summaries.values()))["trials"]
    return [f"{trial['experience_s']:g} s" for trial in trials]


if __name__ == "__main__":
    sys.exit(main())
