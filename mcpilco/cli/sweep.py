"""`mcpilco sweep`: the same training from many seeds, several at a time."""

from __future__ import annotations

import contextlib
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from mcpilco.cli.options import Learning, optional, register, use_one_thread
from mcpilco.typing import InputError


@dataclass(frozen=True, kw_only=True)
class Sweep(Learning):
    """Train from many seeds; the same command goes on where it was stopped."""

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder of the sweep: new, or begun with the same settings"""
    seeds: Annotated[str, tyro.conf.arg(metavar="SEEDS")] = "0:30"
    """`0:30` are 0 to 29; `3,5,7` are these"""
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
        from mcpilco.agent import with_package
        from mcpilco.sweep import (
            LocalEngine,
            RayEngine,
            Settings,
            SweepFolder,
            parse_seeds,
            sweep,
            sweep_progress,
        )

        seeds = parse_seeds(self.seeds)
        register(self.env, self.algo)
        config, env_kwargs = self.numbers()
        self._check(config, env_kwargs)

        # `module:name` tells each process, on whatever machine, where something is registered
        env = self.env if ":" in self.env else f"envs:{self.env}"
        algo = with_package(self.algo)
        task = None if self.task is None else str(self.task)
        numbers = self.chosen_preset, config, self.trials
        settings = Settings(env, env_kwargs, *numbers, self.fresh, task, self.fresh_horizon, algo)
        engine: Any = RayEngine() if self.engine == "ray" else LocalEngine(self.workers)
        done = SweepFolder(self.out, settings).results().keys() & set(seeds)
        try:
            with sweep_progress(len(seeds), len(done), self.quiet) as on_result:
                summary = sweep(settings, seeds, self.out, engine, on_result)
        except KeyboardInterrupt:
            done = SweepFolder(self.out, settings).results().keys() & set(seeds)
            raise KeyboardInterrupt(
                f"{len(done)} of {len(seeds)} seeds are saved in {self.out}; the same command goes "
                "on."
            ) from None
        _print_table(summary)
        print(f"Sweep folder: {shlex.quote(str(self.out))}")
        failed = summary["failed"].keys() & {str(seed) for seed in seeds}
        return 1 if failed else 0

    def _check(self, config: Any, env_kwargs: dict[str, Any]) -> None:
        """Raises McPilcoError where every seed would fail the same way."""
        from mcpilco.agent import make_env

        use_one_thread()
        with contextlib.closing(make_env(self.env, **env_kwargs)) as env:
            self.agent(env, config)


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
