"""How the time of a policy step grows with samples, particles and joints.

    python runs/cost_growth/run.py              # minutes; writes README.md and growth.png
    python runs/cost_growth/run.py --quick --out FOLDER

The system is a chain of k oscillating joints: angles and velocities, one input, a GP for each
velocity, random data. Each size is timed in turn with the others of its row, on one thread.
"""

from __future__ import annotations

import functools
import json
import platform
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import fill, keep, write_picture

from mcpilco.config import Phase, SearchConfig
from mcpilco.dynamics import AngleAugmentation, GPDynamics, speed_integration
from mcpilco.gp import GP
from mcpilco.kernels import MPK, RBF
from mcpilco.policies import SaturatingCost, SumOfGaussians
from mcpilco.search import Adam, PolicySearch, Problem, fused
from mcpilco.sweep import machine as processor
from mcpilco.sweep import markdown
from mcpilco.task import TaskSpec

HERE = Path(__file__).parent
ENGINES = {
    "float64": fused.rollout,
    "float32": functools.partial(fused.rollout, single=True),
}
COLOURS = {"float64": "tab:blue", "float32": "tab:orange"}
BURST = 3
"""timed steps in a row, before it is the next size's turn"""
DROPOUT, LEARNING_RATE = 0.25, 0.01


@dataclass(frozen=True)
class Size:
    """How large a step is."""

    particles: int = 400
    samples: int = 120
    """N, training samples of each GP"""
    steps: int = 60
    """T, horizon"""
    joints: int = 2
    """k; the state has 2 k components, z has 3 k, a GP 3 k + 1 regressors"""
    bases: int = 200


ROWS = {
    "samples": [Size(samples=N) for N in (30, 60, 120, 240, 600)],
    "particles": [Size(particles=P) for P in (50, 100, 200, 400, 800, 1600, 3200)],
    "joints": [Size(joints=k, steps=30) for k in (1, 2, 3, 4, 5, 6)],
}
QUICK = {
    "samples": [Size(4, N, 3, 1, 5) for N in (5, 10, 20)],
    "particles": [Size(P, 5, 3, 1, 5) for P in (4, 8, 16)],
    "joints": [Size(4, 5, 3, k, 5) for k in (1, 2, 3)],
}
TITLES = {"samples": "training samples N", "particles": "particles P", "joints": "joints k"}
LETTERS = {"particles": "P", "samples": "N", "joints": "k", "steps": "T"}
GUIDES = {"samples": (1, 2), "particles": (1,), "joints": (1, 2)}
"""exponents of the power laws drawn beside each row"""


@dataclass(frozen=True)
class Arguments:
    """Time the rows and write the table and the plot."""

    repeats: int = 7
    """turns of each size"""
    quick: bool = False
    """sizes that tell nothing; needs --out"""
    out: Path | None = None
    """folder of results.json, growth.png and README.md, by default this file's"""


def main() -> None:
    arguments = tyro.cli(Arguments, description=__doc__)
    if arguments.quick and arguments.out is None:
        raise SystemExit("--quick would overwrite the measured table; pass --out.")
    torch.set_num_threads(1)
    out = arguments.out or HERE
    out.mkdir(parents=True, exist_ok=True)
    rows = QUICK if arguments.quick else ROWS
    found = {
        "machine": machine(),
        "repeats": arguments.repeats,
        "rows": {axis: timed(axis, sizes, arguments.repeats) for axis, sizes in rows.items()},
    }
    keep(out / "results.json", found, HERE.name)
    write_plot(found["rows"], out / "growth.png")
    write_readme(found, out)
    print(f"Table: {out / 'README.md'}")


def make_step(size: Size, engine: str) -> Callable[[], object]:
    """A policy step of a chain of joints, in a model of random data."""
    k = size.joints
    task = chain(k)
    augmentation = AngleAugmentation(2 * k, task.angles)
    generator = torch.Generator().manual_seed(0)
    X = torch.randn(size.samples, 3 * k + 1, generator=generator, dtype=torch.float64)
    Y = 0.003 * torch.randn(size.samples, k, generator=generator, dtype=torch.float64)
    kernel = RBF(3 * k + 1, (k,)) + MPK(3 * k + 1, 2, (k,))
    kernel.start_from(X, Y)
    posterior = GP(kernel, noise_floor=0.001).condition(X, Y)
    dynamics = GPDynamics(posterior, augmentation, speed_integration(task), np.full(k, 1e3))
    policy = SumOfGaussians(augmentation, [-10.0], [10.0], size.bases)
    span = torch.full((k,), torch.pi, dtype=torch.float64)  # of the velocities
    policy.randomise(span, torch.ones_like(span), 1.0, 5.0, generator)
    start = torch.zeros(2 * k, dtype=torch.float64)
    problem = Problem(dynamics, task.cost, start, start + 0.01, size.steps, 1.0, ENGINES[engine])
    phases = (Phase(LEARNING_RATE, DROPOUT),)
    config = SearchConfig(particles=size.particles, phases=phases, clip_norm=None)
    search = PolicySearch(config, generator)
    adam = Adam(policy)
    return lambda: search.step(problem, policy, adam, LEARNING_RATE, DROPOUT)


def chain(joints: int) -> TaskSpec:
    """k angles, then their velocities."""
    angles = tuple(range(joints))
    return TaskSpec(
        state_names=tuple(f"{what}_{j}" for what in ("angle", "velocity") for j in angles),
        state_units=("rad",) * joints + ("rad/s",) * joints,
        input_names=("torque",),
        input_units=("N m",),
        dt=0.05,
        angles=angles,
        velocities=tuple((j, joints + j) for j in angles),
        start_mean=(0.0,) * (2 * joints),
        start_std=(0.01,) * (2 * joints),
        cost=SaturatingCost(angles, (np.pi,) * joints, (3.0,) * joints, (True,) * joints),
    )


def timed(axis: str, sizes: Sequence[Size], repeats: int) -> dict[str, Any]:
    """CPU milliseconds of a step at each size, in turns; median and quartiles by precision."""
    steps = {(engine, size): make_step(size, engine) for engine in ENGINES for size in sizes}
    times: dict[tuple[str, Size], list[float]] = {key: [] for key in steps}
    for turn in range(1 + repeats):  # the first warms up
        for key, step in steps.items():
            step()  # memory and caches are those of a search, not of another size's step
            taken = [cpu_ms(step) for _ in range(BURST)]
            times[key] += taken if turn else []
    others = (f"{x} = {getattr(sizes[0], name)}" for name, x in LETTERS.items() if name != axis)
    row: dict[str, Any] = {
        "sizes": [getattr(size, axis) for size in sizes],
        "fixed": ", ".join(others),
    }
    for engine in ENGINES:
        spreads = [np.quantile(times[engine, size], (0.25, 0.5, 0.75)) for size in sizes]
        row[engine] = [[round(float(q), 3) for q in spread] for spread in spreads]
    print(axis, json.dumps(row), flush=True)
    return row


def cpu_ms(step: Callable[[], object]) -> float:
    before = time.process_time()
    step()
    return 1e3 * (time.process_time() - before)


def slope(sizes: Sequence[float], ms: Sequence[float]) -> float:
    """d log time / d log size, by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(ms), 1)[0])


def machine() -> dict[str, Any]:
    """Where it was measured."""
    versions = {name: version(name) for name in ("torch", "numba", "numpy")}
    return {**processor(), "python": platform.python_version(), **versions}


# The page -----------------------------------------------------------------------------------------


def write_readme(found: Mapping[str, Any], out: Path) -> None:
    page = out / "README.md"
    if not page.exists():
        page.write_bytes((HERE / "README.md").read_bytes())
    told = dict(found["machine"])
    place = f"{told.pop('cpu')}, {told.pop('cores')} cores"
    versions = ", ".join(f"{name} {value}" for name, value in told.items())
    legend = (
        f"{found['repeats']} turns of each size, of {BURST} steps. Slopes are of log time over log "
        "size, by least squares."
    )
    parts = [table(axis, row) for axis, row in found["rows"].items()]
    where = f"### Machine\n\n{place}; {versions}. One thread."
    fill(page, ["![growth](growth.png)", slopes(found["rows"]), legend, *parts, where])


def slopes(rows: Mapping[str, Any]) -> str:
    """What the times grow with, a row an axis."""
    cells = []
    for axis, row in rows.items():
        upper = slice(len(row["sizes"]) // 2, None)
        found = []
        for engine in ENGINES:
            ms = [median for _, median, _ in row[engine]]
            found += [slope(row["sizes"], ms), slope(row["sizes"][upper], ms[upper])]
        first, middle, last = (row["sizes"][i] for i in (0, upper.start, -1))
        ranges = f"{first}–{last}", f"{middle}–{last}"
        cells.append((TITLES[axis], *ranges, *(f"{value:.2f}" for value in found)))
    kinds = [f"{engine}, {part}" for engine in ENGINES for part in ("all", "upper half")]
    return markdown(("slope over", "all", "upper half", *kinds), cells)


def table(axis: str, row: Mapping[str, Any]) -> str:
    """Times at each size."""
    name, fixed = TITLES[axis], row["fixed"]
    cells = [
        (engine, *(f"{median:.1f} ({low:.1f}–{high:.1f})" for low, median, high in row[engine]))
        for engine in ENGINES
    ]
    header = (name, *map(str, row["sizes"]))
    return f"### Over {name}: CPU ms a step, median (quartiles)\n\n{fixed}.\n\n" + markdown(
        header, cells
    )


def write_plot(rows: Mapping[str, Any], path: Path) -> None:
    figure = Figure(figsize=(11, 3.8), layout="constrained")
    for axis, ax in zip(rows, figure.subplots(1, len(rows)), strict=True):
        plot_growth(axis, rows[axis], ax)
    write_picture(path, figure, dpi=150)


def plot_growth(axis: str, row: Mapping[str, Any], ax: Axes) -> Axes:
    """Times over sizes with quartiles, and power laws through the last of float64."""
    sizes = np.array(row["sizes"], dtype=float)
    for engine, colour in COLOURS.items():
        low, median, high = np.array(row[engine]).T
        ax.fill_between(sizes, low, high, color=colour, alpha=0.3, linewidth=0)
        ax.plot(sizes, median, "o-", color=colour, label=engine)
    last = row["float64"][-1][1]
    for power, style in zip(GUIDES[axis], (":", "--"), strict=False):
        name = "linear" if power == 1 else "quadratic"
        guide = last * (sizes / sizes[-1]) ** power
        ax.plot(sizes, guide, style, color="grey", label=name, zorder=0)
    ax.set(xscale="log", yscale="log", title=row["fixed"])
    ax.set_xlabel(f"{TITLES[axis]} [-]")
    ax.set_ylabel("CPU time of a step [ms]")
    ax.set_xticks(sizes, [f"{size:g}" for size in sizes])
    smallest = min(median for engine in ENGINES for _, median, _ in row[engine])
    ax.set_ylim(bottom=0.7 * smallest)
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.minorticks_off()
    ax.legend(frameon=False)
    return ax


if __name__ == "__main__":
    main()
