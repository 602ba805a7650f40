"""Forces that no equation holds: what the kernel part `gip` adds to a model with equations.

python runs/missing_forces/run.py --quick                        # does it run at all?
python runs/missing_forces/run.py                                # all cells, seeds 3000:3010
python runs/missing_forces/run.py --systems spring --seeds 3000:3002

Results are kept in results/<system>/<model>/, a file a seed; the same command goes on where it was
stopped, and rewrites README.md between its marked lines from all results that are there.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import broken_off, fill, folder, hasty, machines, parse_seeds, read_summaries, swept

from mcpilco.config import CART_POLE, Config, ModelConfig
from mcpilco.sweep import Settings, markdown, mean_cell, seed_job, spread_cell

HERE = Path(__file__).parent
FRESH, TRIALS = 50, 2
"""rollouts that a policy is judged by, and policies to learn"""
WRONG = 0.2
"""a nominal mass is wrong by up to this part of it, in either direction"""
MASSES = ("cart_mass", "pole_mass")
UNKNOWN = {"cart_mass": 1.0, "pole_mass": 1.0, "pole_length": 1.0}
"""numbers of a cart-pole of which the kinds of joints are known alone; the true ones are 0.5"""
MODELS = {
    "rbf+mpk": ModelConfig(),
    "physics+rbf": ModelConfig(kernel="rbf", mean="physics"),
    "physics+gip+rbf": ModelConfig(kernel="gip+rbf", mean="physics"),
}


def effect(name: str, target: str, **parameters: float) -> dict[str, Any]:
    """An effect of a system, as the file of a correction has it."""
    return {"name": name, "target": target, "parameters": parameters}


SYSTEMS: Mapping[str, list[dict[str, Any]]] = {
    "spring": [effect("spring", "cart", k=8.0)],
    "magnet": [effect("position_ripple", "pole", s=0.3, c=0.0, n=2.0)],
    "links": [],
}
"""the forces that a system has and the model's equations have not"""


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "3000:3010"
    """`3000:3010` are 3000 to 3009"""
    systems: tuple[Literal[*SYSTEMS], ...] = tuple(SYSTEMS)
    """which of them"""
    models: tuple[Literal[*MODELS], ...] = tuple(MODELS)
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
    for system in arguments.systems:
        for name in arguments.models:
            failed |= bool(run(system, name, arguments, out)["failed"])
            write_readme(out)  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return int(failed)


def run(system: str, name: str, arguments: Arguments, out: Path) -> dict[str, Any]:
    """Train the seeds of a system and a model that are missing; their summary."""
    config, seeds, trials, fresh = Config(model=MODELS[name]), arguments.seeds, TRIALS, FRESH
    if arguments.quick:
        config, trials, fresh = hasty(config), 1, 4
    kwargs = {"effects": described({}, SYSTEMS[system])} if SYSTEMS[system] else {}
    settings = Settings(f"envs:{CART_POLE}", kwargs, name, config, trials, fresh)
    chosen = parse_seeds(seeds)[: 1 if arguments.quick else None]
    print(f"{system}, {name}, {len(chosen)} seeds of {trials} trials:", flush=True)
    path = out / "results" / system / name
    job = partial(job_of, system)
    return swept(settings, chosen, path, HERE.name, arguments.workers, make_job=job)


def job_of(system: str, settings: Settings, seed: int) -> partial[dict[str, Any]]:
    """The training of a seed; what its model knows of the plant is wrong, or next to nothing."""
    model = settings.config.model
    if model.mean == "physics":
        numbers = wrong_masses(seed) if SYSTEMS[system] else UNKNOWN
        uncertainty = model.uncertainty if SYSTEMS[system] else 0.0
        model = replace(model, plant=described(numbers, []), uncertainty=uncertainty)
        settings = replace(settings, config=replace(settings.config, model=model))
    return seed_job(settings, seed)


def described(parameters: Mapping[str, float], effects: list[dict[str, Any]]) -> dict[str, Any]:
    """A correction of the cart-pole."""
    plant = {"plant": CART_POLE, "parameters": dict(parameters), "effects": effects}
    return {"format": 1, **plant}


def wrong_masses(seed: int) -> dict[str, float]:
    """Nominal masses of a seed [kg]; the true ones are 0.5."""
    rng = np.random.default_rng([seed, 7])
    return {name: 0.5 * (1.0 + float(rng.uniform(-WRONG, WRONG))) for name in MASSES}


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    found = {system: read_summaries(out / "results" / system, MODELS) for system in SYSTEMS}
    everywhere = {f"{s}/{m}": summary for s, of in found.items() for m, summary in of.items()}
    parts = [table(everywhere), *broken_off(everywhere), machines(everywhere)]
    fill(
        out / "README.md",
        parts if everywhere else ["Not measured yet."],
        template=HERE / "README.md",
    )


def table(found: Mapping[str, Any]) -> str:
    """Success over fresh rollouts by experience: a row a system and a model."""
    longest = max((s["trials"] for s in found.values()), key=len)
    header = ["system", "model", "seeds"]
    header += [f"p after {trial['experience_s']:g} s [%]" for trial in longest] + ["CPU [s]"]
    rows = []
    for name, summary in found.items():
        system, _, model = name.partition("/")
        shares = [mean_cell(trial["p"]) for trial in summary["trials"]]
        cpu = spread_cell(summary["run"]["cpu_s"], 0)
        rows.append((system, f"`{model}`", str(len(summary["seeds"])), *shares, cpu))
    return markdown(header, rows)


if __name__ == "__main__":
    sys.exit(main())
