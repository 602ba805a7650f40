"""`mcpilco sweep`: the same training from many seeds, several at a time."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from mcpilco.cli.learning import Learning
from mcpilco.cli.options import optional
from mcpilco.cli.system import open_env, use_one_thread, with_package
from mcpilco.typing import InputError

_SPEED_PERIOD_S = 3600.0  # seeds end rarely: the time left is estimated from the last hour


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
        """Train, print the table, and return the exit code: 1 when a seed failed.

        Raises:
            McPilcoError: a wrong input; the sentence says which.
        """
        seeds = parse_seeds(self.seeds)
        if self.engine == "ray" and self.workers is not None:
            raise InputError("--workers is for the engine local; Ray takes all cores it has.")
        config, env_kwargs = self.numbers()
        self._check(config, env_kwargs)

        from mcpilco.sweep import Settings, SweepFolder, sweep

        # `module:name` tells each process, on whatever machine, where something is registered
        env = self.env if ":" in self.env else f"envs:{self.env}"
        algo = with_package(self.algo)
        settings = Settings(
            env,
            env_kwargs,
            self.chosen_preset,
            config,
            self.trials,
            self.fresh,
            None if self.task is None else str(self.task),
            self.fresh_horizon,
            algo,
        )
        engine = self._engine()
        done = SweepFolder(self.out, settings).results().keys() & set(seeds)
        try:
            with progress(len(seeds), len(done), self.quiet) as on_result:
                summary = sweep(settings, seeds, self.out, engine, on_result)
        except KeyboardInterrupt:
            done = SweepFolder(self.out, settings).results().keys() & set(seeds)
            print(
                f"mcpilco: interrupted; {len(done)} of {len(seeds)} seeds are saved in {self.out}; "
                "the same command goes on.",
                file=sys.stderr,
            )
            return 130
        _print_table(summary)
        print(f"Sweep folder: {shlex.quote(str(self.out))}")
        failed = summary["failed"].keys() & {str(seed) for seed in seeds}
        return 1 if failed else 0

    def _check(self, config: Any, env_kwargs: dict[str, Any]) -> None:
        """Raises McPilcoError where every seed would fail the same way."""
        use_one_thread()
        with contextlib.closing(open_env(self.env, env_kwargs)) as env:
            self.agent(env, config)

    def _engine(self) -> Any:
        from mcpilco.sweep import LocalEngine, RayEngine

        return RayEngine() if self.engine == "ray" else LocalEngine(self.workers)


def parse_seeds(text: str) -> Sequence[int]:
    """The seeds that `0:30` or `3,5,7` stand for.

    Raises:
        InputError: it is neither, or holds a negative number or none.
    """
    try:
        if ":" in text:
            first, end = text.split(":")
            seeds = list(range(int(first), int(end)))
        else:
            seeds = sorted({int(seed) for seed in text.split(",")})
    except ValueError:
        seeds = []
    if not seeds or min(seeds) < 0 or max(seeds) >= 2**32:
        raise InputError(
            f"--seeds must be like 0:30, which are 0 to 29, or like 3,5,7, got {text!r}."
        )
    return seeds


@contextlib.contextmanager
def progress(seeds: int, done: int, quiet: bool) -> Iterator[Any]:
    """What `sweep` tells each result; draws a line for each, above a bar on a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as TimeLeft

    console = Console(quiet=quiet)
    bar = Progress(
        TextColumn("seeds"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeLeft(),
        console=console,
        speed_estimate_period=_SPEED_PERIOD_S,
        disable=quiet or not console.is_terminal,
    )
    if done:
        console.print(f"{done} of {seeds} seeds are there already.", highlight=False)
    with bar:
        task = bar.add_task("seeds", total=seeds, completed=done)

        def on_result(seed: int, outcome: Any) -> None:
            bar.console.print(_line(seed, outcome), markup=False, highlight=False, soft_wrap=True)
            bar.advance(task)

        yield on_result


def _line(seed: int, outcome: Any) -> str:
    from mcpilco.sweep import Failure

    if isinstance(outcome, Failure):
        return f"seed {seed} failed: {outcome.reason}"
    trials = outcome["trials"]
    words = {True: "yes", False: "no", None: "-"}
    success = " ".join(words[row["success"]] for row in trials)
    returns = " ".join(f"{row['return']:.1f}" for row in trials if row["return"] is not None)
    cpu = sum(row["cpu_s"] for row in trials)
    return f"seed {seed}: success {success}, return {returns}, {cpu:.1f} CPU s"


def _print_table(summary: Any) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from mcpilco.sweep.summary import LEGEND, conclusion, table

    header, rows = table(summary)
    shown = Table(box=SIMPLE_HEAD, caption=LEGEND, padding=(0, 0, 0, 1), pad_edge=False)
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
