"""`mcpilco compare`: sweeps and runs beside one another, in tables and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mcpilco.cli.options import Command, optional, warn

if TYPE_CHECKING:
    from mcpilco.sweep import Estimate, LineUp, Measure

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
