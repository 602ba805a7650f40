"""What each choice of the preset `default` is worth: success and CPU time without it.

python runs/recipe/run.py --quick    # does it run at all? compiles the loops, too
python runs/recipe/run.py            # all settings on both systems, seeds 0:10, 4 trials each
python runs/recipe/run.py --settings default no-polish --systems pendulum

Results are kept in results/<system>/<setting>/, a file a seed; the same command goes on where it
was stopped, and rewrites README.md between its marked lines from all results that are there.
"""

from __future__ import annotations

import math
import statistics
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import broken_off, fill, folder, hasty, machines, parse_seeds, read_summaries, swept

from mcpilco.config import PRESETS, Config, ModelConfig, PolicyConfig, SearchConfig
from mcpilco.logbook import read_json
from mcpilco.sweep import (
    Settings,
    markdown,
    mean,
    mean_cell,
    spread_cell,
)

HERE = Path(__file__).parent
TRIALS, FRESH = 4, 100
SOLVED = 0.9
"""least p of a policy that solves the task"""

SYSTEMS = {"cartpole": "envs:mcpilco/CartPoleSwingUp-v0", "pendulum": "envs:mcpilco/Pendulum-v0"}
DEFAULT = replace(
    PRESETS["default"].config,
    model=ModelConfig(prior_std=None, mirror=60),
    policy=PolicyConfig(span="data"),
    search=SearchConfig(
        particles=96,
        steps=(500,),
        failing=0.05,
        screening=1.0,
        correlations=(0.0, 0.0, 0.0, 0.8),
    ),
    excitation="random",
    precision="float64",
)
"""the preset default as it was when its parts were compared"""


def searching(**changes: Any) -> Config:
    """That preset, its search changed."""
    return replace(DEFAULT, search=replace(DEFAULT.search, **changes))


def dropping(*rates: float) -> Config:
    """That preset with these dropout rates in its phases."""
    phases = zip(DEFAULT.search.phases, rates, strict=True)
    return searching(phases=tuple(replace(phase, dropout=rate) for phase, rate in phases))


SETTINGS = {
    "default": DEFAULT,
    "float32": replace(DEFAULT, precision="float32"),
    "no-polish": searching(polish=False),
    "no-widening": searching(widening=1.0),
    "no-mirror": replace(DEFAULT, model=replace(DEFAULT.model, mirror=0)),
    "uncorrelated": searching(correlations=(0.0,)),
    "correlated-always": searching(correlations=(0.8,)),
    "one-start": searching(restarts=(0,)),
    "four-starts-first": searching(restarts=(3,)),
    "screened": searching(restarts=(3, 5), screening=0.3),
    "250-steps": searching(steps=(250,)),
    "1000-steps": searching(steps=(1000,)),
    "no-clipping": searching(clip_norm=None),
    "dropout": dropping(0.25, 0.125, 0.0),
    "step-eager": replace(DEFAULT, engine="eager"),
    "path": replace(DEFAULT, engine="eager", model=replace(DEFAULT.model, sampling="path")),
}
"""that preset with one change each; path rolls out in plain torch, as step-eager does"""
CARTPOLE_ONLY = ("step-eager", "path")


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "0:10"
    """`0:10` are 0 to 9"""
    settings: tuple[Literal[*SETTINGS], ...] = tuple(SETTINGS)
    """which of them; step-eager and path are for the cart-pole only"""
    systems: tuple[Literal[*SYSTEMS], ...] = tuple(SYSTEMS)
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
        for system in arguments.systems:
            if system == "cartpole" or name not in CARTPOLE_ONLY:
                failed |= bool(run(system, name, arguments, out)["failed"])
        write_readme(out)  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return int(failed)


def run(system: str, name: str, arguments: Arguments, out: Path) -> dict[str, Any]:
    """Train the seeds of a setting that are missing; its summary."""
    env, config = SYSTEMS[system], SETTINGS[name]
    seeds = parse_seeds(arguments.seeds)
    settings = Settings(env, {}, name, config, TRIALS, FRESH)
    if arguments.quick:
        seeds = seeds[:1]
        settings = Settings(env, {}, name, hasty(config), trials=1, fresh=5)
    print(f"{system}, {name}, {len(seeds)} seeds of {settings.trials} trials:", flush=True)
    path = out / "results" / system / name
    return swept(settings, seeds, path, HERE.name, arguments.workers)


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    parts: list[str] = []
    everywhere = {}
    for system, env in SYSTEMS.items():
        results = out / "results" / system
        summaries = read_summaries(results, SETTINGS)
        everywhere |= {f"{system}/{name}": summary for name, summary in summaries.items()}
        told = {name: summary for name, summary in summaries.items() if summary["trials"]}
        if told:
            heading = f"### `{env.partition(':')[2]}`"
            parts += [heading, table(told, results), differences(told)]
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


def differences(summaries: Mapping[str, Any], base: str = "default") -> str:
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
