"""The comparison on the cart-pole: MC-PILCO, PILCO and stable-baselines3 on one protocol.

python runs/cartpole_comparison/run.py                              # the thesis's comparison: hours
python runs/cartpole_comparison/run.py --rows sac tqc ppo           # model-free: hours a row
python runs/cartpole_comparison/run.py --env mujoco                 # the same in MuJoCo
python runs/cartpole_comparison/run.py --seeds 20:21 --rows mcpilco pilco    # a seed: minutes

Results are kept in results/<env>/<row>/, a file a seed; the same command goes on where it was
stopped, and rewrites the pictures, and README.md between its markers, from all results that are
there; the README of the project has the tables of experience, too.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

sys.path.append(str(Path(__file__).parents[1]))  # its modules, and the thesis's tables

from cartpole_comparison import pictures, tables
from cartpole_comparison.seed_curve import CurveJob, CurveSettings
from harness import (
    code_of,
    costs,
    failures,
    fill,
    machines,
    parse_seeds,
    preset_settings,
    read_summaries,
    swept,
)

from mcpilco.sweep import Failure, Run, read_run

HERE = Path(__file__).parent
SYSTEMS = {
    "cartpole": "mcpilco/CartPoleSwingUp-v0",
    "mujoco": "mcpilco/MujocoCartPoleSwingUp-v0",
}
DT = 0.1
TRIALS, FRESH = 4, 100
AMOUNTS = (12, 30, 60, 120, 300, 600, 1200, 1800, 2700, 3600)
"""experience after which what learns without a model is judged [s]"""


@dataclass(frozen=True)
class Row:
    """An agent of the tables."""

    algo: str
    preset: str = "default"
    amounts: tuple[int, ...] = ()
    """experience after which it is judged [s]; none: after each of `TRIALS` trials"""
    seeds: str = "20:50"
    """by default; no number of the row was chosen on them"""


ROWS: Mapping[str, Row] = {
    "mcpilco": Row("mcpilco", seeds="28200:28230"),
    "pilco": Row("pilco"),
    "pilco-restarts": Row("pilco", "restarts"),
    "pilco-tip": Row("pilco", "tip"),
    "sac": Row("sac", amounts=AMOUNTS, seeds="30:40"),
    "tqc": Row("tqc", amounts=AMOUNTS, seeds="30:40"),
    "ppo": Row("ppo", amounts=AMOUNTS[2:], seeds="30:40"),  # it learns from 60 s at a time
}


@dataclass(frozen=True)
class Arguments:
    """Train from many seeds and write the tables."""

    seeds: str | None = None
    """`20:50` are 20 to 49; by default these, for mcpilco 28200:28230, for sac, tqc, ppo 30:40"""
    rows: tuple[Literal[*ROWS], ...] = (
        "mcpilco",
        "pilco",
        "pilco-restarts",
        "pilco-tip",
    )
    """which agents: MC-PILCO, PILCO with the thesis's cost, with MC-PILCO's restarts besides, with
    its own cost, and those of stable-baselines3"""
    env: Literal["cartpole", "mujoco"] = "cartpole"
    """analytic, or MuJoCo's"""
    workers: int | None = None
    """processes at a time; by default one a core"""
    out: Path = HERE
    """folder of results/, pictures and README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    codes = []
    for name in arguments.rows:
        print(f"{name}:", flush=True)
        row, out = ROWS[name], arguments.out / "results" / arguments.env / name
        codes.append((by_amounts if row.amounts else by_trials)(row, arguments, out))
        write_readme(arguments.out)  # a stop loses no table
    print(f"Tables: {arguments.out / 'README.md'}")
    return max(codes)


def by_trials(row: Row, arguments: Arguments, out: Path) -> int:
    """Train the seeds that are missing, judged after each trial."""
    seeds = parse_seeds(arguments.seeds or row.seeds)
    settings = preset_settings(SYSTEMS[arguments.env], row.algo, row.preset, TRIALS, FRESH)
    return code_of(swept(settings, seeds, out, HERE.name, arguments.workers), seeds)


def by_amounts(row: Row, arguments: Arguments, out: Path) -> int:
    """Train the seeds that are missing, judged after amounts of experience."""
    seeds, env = parse_seeds(arguments.seeds or row.seeds), SYSTEMS[arguments.env]
    settings = CurveSettings(
        **vars(preset_settings(env, row.algo, row.preset, len(row.amounts), FRESH)),
        amounts=tuple(round(seconds / DT) for seconds in row.amounts),
    )
    make_job = functools.partial(CurveJob, checkpoints=out.with_name(f"{out.name}-checkpoints"))

    def forget(seed: int, outcome: object) -> None:
        if not isinstance(outcome, Failure):
            make_job(settings, seed).forget()

    summary = swept(settings, seeds, out, HERE.name, arguments.workers, forget, make_job)
    return code_of(summary, seeds)


def write_readme(out: Path) -> None:
    """Put pictures and tables of the results that are there into README.md."""
    parts: list[str] = []
    everywhere = {}
    for system, env in SYSTEMS.items():
        summaries = read_summaries(out / "results" / system, ROWS)
        everywhere |= {f"{system}/{name}": summary for name, summary in summaries.items()}
        names = [name for name, summary in summaries.items() if summary["trials"]]
        if names:
            runs = [read_run(out / "results" / system / name) for name in names]
            parts += [f"### `{env}`", *pictured(out, system, runs)]
            trained = {name: summaries[name] for name in names if not ROWS[name].amounts}
            parts += tables.thesis_tables(trained, published=system == "cartpole")
            parts += tables.foresight(out / "results" / system, list(trained))
            parts += tables.experience_tables(runs)
            if out == HERE and system == "cartpole":
                fill(HERE.parents[1] / "README.md", tables.overview(runs), name="comparison")
    trained = {k: s for k, s in everywhere.items() if not ROWS[k.partition("/")[2]].amounts}
    parts += [costs(trained), failures(everywhere), machines(everywhere)]
    fill(out / "README.md", parts, template=HERE / "README.md")


def pictured(out: Path, system: str, runs: list[Run]) -> list[str]:
    """The pictures of a system, written, as parts of the page."""
    trained = [run for run in runs if not ROWS[run.name].amounts]
    parts = []
    if trained:
        pictures.write_trials(out / f"{system}-trials.png", trained, published=system == "cartpole")
        parts.append(f"![Time up, distance and return after each trial]({system}-trials.png)")
    pictures.write_experience(out / f"{system}-experience.png", runs)
    parts.append(f"![Success over experience and over processor time]({system}-experience.png)")
    return parts


if __name__ == "__main__":
    sys.exit(main())
