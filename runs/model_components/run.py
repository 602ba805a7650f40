"""What each component of the model is worth: success after 3, 6, 9 and 12 s of experience.

python runs/model_components/run.py --quick                  # does it run at all?
python runs/model_components/run.py                          # all cells, seeds 0:30: CPU hours
python runs/model_components/run.py --cells physics+rbf --seeds 0:10

Results are kept in results/<system>/<cell>/, a file a seed; the same command goes on where it was
stopped, and rewrites README.md between its marked lines from all results that are there.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import broken_off, fill, folder, machines, parse_seeds, read_summaries, swept

from mcpilco.config import CART_POLE, CART_POLES, PRESETS, Config, ModelConfig, SearchConfig
from mcpilco.sweep import Settings, markdown, mean_cell, rate_cell, seed_job, spread_cell

HERE = Path(__file__).parent
FRESH = 50
SYSTEMS = dict(zip(("analytic", "mujoco"), CART_POLES, strict=True))
WRONG = 0.2
"""a nominal mass is wrong by up to this part of it, in either direction"""
MASSES = ("cart_mass", "pole_mass")


USUAL = SearchConfig()
THOROUGH = PRESETS["thorough"].config.search


def described(
    parameters: Mapping[str, float], delay: float = 0.0, lag: float = 0.0
) -> dict[str, Any]:
    """A correction of the cart-pole."""
    late = (("actuator_delay", {"d": delay}), ("actuator_lag", {"T": lag}))
    return {
        "format": 1,
        "plant": CART_POLE,
        "parameters": dict(parameters),
        "effects": [
            {"name": name, "target": "actuator", "parameters": numbers}
            for name, numbers in late
            if any(numbers.values())
        ],
    }


@dataclass(frozen=True)
class Cell:
    """A model, and the actuator that it meets."""

    model: ModelConfig
    """its masses are wrong where it knows a plant"""
    delay: float = 0.0
    """of the actuator [s]"""
    lag: float = 0.0
    """of the actuator: its time constant [s]"""
    trials: int = 4
    """policies to learn"""
    search: SearchConfig = USUAL
    """how policies are searched"""


def physics(kernel: str, search: SearchConfig = USUAL) -> Cell:
    """The plant's equations, whose nominal masses are wrong, and a residual."""
    return Cell(ModelConfig(kernel=kernel, mean="physics"), trials=2, search=search)


CELLS: Mapping[str, Cell] = {
    "rbf": Cell(ModelConfig(kernel="rbf")),
    "mpk": Cell(ModelConfig(kernel="mpk")),
    "rbf+mpk": Cell(ModelConfig()),
    "features+rbf": Cell(ModelConfig(kernel="features+rbf")),
    "friction+rbf+mpk": Cell(ModelConfig(kernel="friction+rbf+mpk")),
    "physics+rbf": physics("rbf"),
    "physics+rbf-thorough": physics("rbf", THOROUGH),
    "physics+mpk": physics("mpk"),
    "physics+gip+rbf": physics("gip+rbf"),
    "delay-1": Cell(ModelConfig(), delay=0.1, trials=3),
    "delay-1-predicted": Cell(ModelConfig(delay=0.1), delay=0.1),
    "delay-1.5": Cell(ModelConfig(), delay=0.15, trials=3),
    "delay-1.5-predicted": Cell(ModelConfig(delay=0.15), delay=0.15, trials=5),
    "delay-2": Cell(ModelConfig(), delay=0.2, trials=3),
    "delay-2-predicted": Cell(ModelConfig(delay=0.2), delay=0.2, trials=5),
    "lag": Cell(ModelConfig(), lag=0.1),
    "lag-memory": Cell(ModelConfig(memory=3), lag=0.1),
    "lag-sed-mpk": Cell(ModelConfig(kernel="sed-mpk+rbf+mpk", memory=3), lag=0.1),
    "lag-sed-fir": Cell(ModelConfig(kernel="sed-fir", memory=3), lag=0.1),
}


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str = "0:30"
    """`0:30` are 0 to 29"""
    cells: tuple[Literal[*CELLS], ...] = tuple(CELLS)
    """which of them"""
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
    for name in arguments.cells:
        for system in arguments.systems:
            if system == "analytic" or not disturbed(CELLS[name]):  # MuJoCo's answers at once
                failed |= bool(run(system, name, arguments, out)["failed"])
            write_readme(out)  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return int(failed)


def run(system: str, name: str, arguments: Arguments, out: Path) -> dict[str, Any]:
    """Train the seeds of a cell that are missing; its summary."""
    cell, seeds = CELLS[name], parse_seeds(arguments.seeds)
    config, trials, fresh = Config(model=cell.model, search=cell.search), cell.trials, FRESH
    if arguments.quick:
        search = SearchConfig(particles=8, steps=(2,), restarts=(0,), evaluation_particles=8)
        config, seeds, trials, fresh = replace(config, search=search), seeds[:1], 1, 4
    settings = Settings(f"envs:{SYSTEMS[system]}", disturbed(cell), name, config, trials, fresh)
    print(f"{system}, {name}, {len(seeds)} seeds of {trials} trials:", flush=True)
    path = out / "results" / system / name
    return swept(settings, seeds, path, HERE.name, arguments.workers, make_job=job_of)


def disturbed(cell: Cell) -> dict[str, Any]:
    """What the env of a cell is made with; nothing where its actuator is ideal."""
    if not (cell.delay or cell.lag):
        return {}
    return {"effects": described({}, cell.delay, cell.lag)}


def job_of(settings: Settings, seed: int) -> partial[dict[str, Any]]:
    """The training of a seed; its nominal masses are wrong where the model knows a plant."""
    model = settings.config.model
    if model.mean == "physics" or "features" in model.kernel.split("+"):
        wrong = replace(model, plant=described(wrong_masses(seed)))
        settings = replace(settings, config=replace(settings.config, model=wrong))
    return seed_job(settings, seed)


def wrong_masses(seed: int) -> dict[str, float]:
    """Nominal masses of a seed [kg]; the true ones are 0.5."""
    rng = np.random.default_rng([seed, 7])
    return {name: 0.5 * (1.0 + float(rng.uniform(-WRONG, WRONG))) for name in MASSES}


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    parts: list[str] = []
    everywhere = {}
    for system in SYSTEMS:
        found = read_summaries(out / "results" / system, CELLS)
        everywhere |= {f"{system}/{name}": summary for name, summary in found.items()}
        for title, measure in (("One rollout a policy [%]", "success"), ("p [%]", "p")):
            if any(summary["trials"] for summary in found.values()):
                parts += [f"### {system}: {title}", table(found, measure)]
    broken = broken_off(everywhere)
    parts += ["### Seeds that broke off\n\n" + "\n".join(broken)] if broken else []
    parts += [machines(everywhere)] if everywhere else ["Not measured yet."]
    fill(out / "README.md", parts, template=HERE / "README.md")


def table(found: Mapping[str, Any], measure: Literal["success", "p"]) -> str:
    """Success by experience: a row a cell."""
    cell = rate_cell if measure == "success" else mean_cell
    longest: Sequence[Mapping[str, Any]] = max((s["trials"] for s in found.values()), key=len)
    experience = [f"{trial['experience_s']:g} s" for trial in longest]
    rows = []
    for name, summary in found.items():
        trials = summary["trials"]
        told = [cell(trial[measure]) for trial in trials]
        told += [""] * (len(experience) - len(told))
        cpu = spread_cell(summary["run"]["cpu_s"], 0)
        rows.append((f"`{name}`", str(len(summary["seeds"])), *told, cpu))
    return markdown(("cell", "seeds", *experience, "CPU [s]"), rows)


if __name__ == "__main__":
    sys.exit(main())
