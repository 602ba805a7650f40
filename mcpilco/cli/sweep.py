"""`mcpilco sweep` and `compare`: the same training from many seeds; sweeps beside one another."""

from __future__ import annotations

import contextlib
import shlex
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mcpilco.cli.options import Command, Learning, optional, register, use_one_thread, warn
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.sweep import Estimate, LineUp, Measure


@dataclass(frozen=True, kw_only=True)
class Sweep(Learning):
    """Train from many seeds; the same command goes on where it was stopped."""

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder of the sweep: new, or begun with the same settings"""
    seeds: Annotated[str, tyro.conf.arg(metavar="SEEDS")] = "0:30"
    """`0:30` are 0 to 29, `3,5,7` are these, `0:30,40` are both"""
    trials: int = 4
    """policies to learn from each seed"""
    fresh: int = 100
    """fresh rollouts that each policy is judged by"""
    engine: Literal["local", "ray"] = "local"
    """local: processes of this machine; ray: the Ray cluster that RAY_ADDRESS names"""
    workers: Annotated[int | None, optional("INT", "number of cores")] = None
    """processes at a time; Ray takes all cores it has"""
    fresh_horizon: Annotated[int | None, optional("INT", "that of the training")] = None
    """steps of a fresh rollout"""
    quiet: bool = False
    """show no progress"""

    def __call__(self) -> int:
        """Train, print the table, and return the exit code: 1 when a seed failed."""
        if self.engine == "ray" and self.workers is not None:
            raise InputError("--workers is for the engine local; Ray takes all cores it has.")
        from mcpilco import sweep
        from mcpilco.agent import make_env, with_package

        seeds = sweep.parse_seeds(self.seeds)
        register(self.env, self.algo)
        config, env_kwargs = self.numbers()
        use_one_thread()
        with contextlib.closing(make_env(self.env, **env_kwargs)) as made:
            self.agent(made, config)  # raises where every seed would fail the same way

        # `module:name` tells each process, on whatever machine, where something is registered
        env = self.env if ":" in self.env else f"envs:{self.env}"
        algo = with_package(self.algo)
        task = None if self.task is None else str(self.task)
        numbers = self.chosen_preset, config, self.trials
        settings = sweep.Settings(
            env, env_kwargs, *numbers, self.fresh, task, self.fresh_horizon, algo
        )
        engine: Any = sweep.RayEngine() if self.engine == "ray" else sweep.LocalEngine(self.workers)
        folder = sweep.SweepFolder(self.out, settings)
        done = folder.results().keys() & set(seeds)
        try:
            with sweep.sweep_progress(len(seeds), len(done), self.quiet) as on_result:
                summary = sweep.sweep(settings, seeds, self.out, engine, on_result)
        except KeyboardInterrupt:
            done = folder.results().keys() & set(seeds)
            raise KeyboardInterrupt(
                f"{len(done)} of {len(seeds)} seeds are saved in {self.out}; the same command goes "
                "on."
            ) from None
        _print_table(summary)
        print(f"Sweep folder: {shlex.quote(str(self.out))}")
        failed = summary["failed"].keys() & {str(seed) for seed in seeds}
        return 1 if failed else 0


def _print_table(summary: Any) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from mcpilco.sweep import SUMMARY_LEGEND, conclusion, summary_table

    header, rows = summary_table(summary)
    shown = Table(box=SIMPLE_HEAD, caption=SUMMARY_LEGEND, padding=(0, 0, 0, 1), pad_edge=False)
    for name in header:
        heading = Text("\n".join(name.rsplit(" ", 1)))  # a unit is no markup
        shown.add_column(heading, justify="right", vertical="bottom")
    for row in rows:
        shown.add_row(*(cell.replace(" (", "\n(") for cell in row))  # to fit 80 columns
    console = Console()
    console.print(shown)
    for seed, reason in summary["failed"].items():
        console.print(f"seed {seed} failed: {reason}", markup=False, highlight=False)
    console.print(conclusion(summary), highlight=False)


_OUT = "runs/out"
_CAPTION = (
    "Mean of success and p, the share of fresh rollouts that succeed; interquartile mean of all "
    "else; 95 % intervals. CPU: of the whole training."
)


@dataclass(frozen=True)
class Compare(Command):
    """Lay sweeps and runs beside one another, in tables and pictures."""

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN...")]
    """folders of `mcpilco sweep` or `mcpilco train`; runs that differ in their seed only are one"""
    out: Annotated[Path | None, optional("FOLDER", f"{_OUT}/compare-<time>")] = None
    """folder of the tables and pictures"""

    def __call__(self) -> int:
        """Compare, print how each ends, and return the exit code: 1 when a folder is left out."""
        from mcpilco.show import write_comparison
        from mcpilco.sweep import line_up

        found = line_up(self.runs)
        out = self.out or Path(_OUT) / f"compare-{datetime.now():%Y%m%d-%H%M%S}"
        page, *_ = write_comparison(found, out)
        _print_last(found)
        warn(*found.cautions, about="mcpilco: note")
        warn(*found.left_out)
        print(f"Tables: {page}")
        return 1 if found.left_out else 0


def _print_last(found: LineUp) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from mcpilco.sweep import estimate, measures

    told = [
        measure
        for measure in measures(found.runs)
        if measure.short and any(run.at(run.amounts[-1], measure.key) for run in found.runs)
    ]
    table = Table(box=SIMPLE_HEAD, padding=(0, 0, 0, 1), pad_edge=False, caption=_CAPTION)
    table.add_column("run", overflow="fold")
    for measure in told:
        heading = Text(f"{measure.short}\n[{measure.unit}]")
        table.add_column(heading, justify="right", no_wrap=True)
    for run in found.runs:
        last = float(run.amounts[-1])
        cells = []
        for measure in told:
            values = list(run.at(last, measure.key).values())
            cells.append(_cell(estimate(values, measure, measure.statistics[0]), measure))
        seeds = len(run.courses)
        told_of = f"{seeds} seed{'s' * (seeds > 1)}, {last:g} s"
        table.add_row(Text(f"{run.name}\n{told_of}"), *cells)
    Console().print(table)


def _cell(found: Estimate | None, measure: Measure) -> str:
    """A value, and its interval below it; both short."""
    if found is None:
        return ""
    digits = 0 if measure.unit == "%" else measure.digits
    value = f"{found.value:.{measure.digits}f}"
    if found.low is None or found.high is None:
        return value
    return f"{value}\n{found.low:.{digits}f}–{found.high:.{digits}f}"
