"""A comparison of runs as files: tidy CSV for programs, Markdown and pictures for people."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mcpilco import sweep
from mcpilco.files import csv_bytes, make_folder, write_bytes
from mcpilco.show.plots.style import add_legend, new_axes, write_picture
from mcpilco.show.plots.training import Curve, plot_curves, plot_seeds

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLUMNS = "run", "measure", "unit", "statistic", "experience_s", "seeds", "value", "low", "high"
_NAMES = {"mean": "mean", "median": "median", "iqm": "interquartile mean"}

_FILES = (
    *("comparison.md", "comparison.csv", "differences.csv", "seeds.csv"),
    *("curves.png", "seeds.png"),
)

LEGEND = (
    f"In brackets: {sweep.CONFIDENCE:.0%} intervals, Wilson's for success of the one test rollout "
    "of each policy, the bootstrap over seeds for all else; none where there is one seed. The "
    "interquartile mean is that of the middle half of the seeds. Processor time is of all trials "
    "so far."
)


def write_comparison(found: sweep.LineUp, out: Path) -> list[Path]:
    """Write tables and pictures; returns their paths, that of the page first.

    comparison.md      all tables
    comparison.csv     statistics over seeds: a row a run, measure, statistic and amount; shares
                       in percent
    differences.csv    the same of differences between two runs, `run` minus `other`, seed by seed
    seeds.csv          what each seed reached
    curves.png         learning curves
    seeds.png          how the seeds are spread

    What an earlier comparison left in the folder is replaced.

    Raises:
        InputError: matplotlib is missing.
        RunFolderError: a file cannot be written.
    """
    make_folder(out, *_FILES)
    rows, gains = sweep.estimates(found.runs), sweep.differences(found.runs)
    *tables, curves, seeds = (out / name for name in _FILES)
    contents = (
        page(found, rows, gains).encode(),
        _csv(_COLUMNS, ((row.run, *_cells(row)) for row in rows)),
        _csv(("run", "other", *_COLUMNS[1:]), ((r.run, r.other, *_cells(r)) for r in gains)),
        seeds_csv(found.runs),
    )
    written = [write_bytes(path, content) for path, content in zip(tables, contents, strict=True)]
    return [*written, write_curves(curves, found.runs, rows), write_seeds(seeds, found.runs)]


def seeds_csv(runs: Sequence[sweep.Run]) -> bytes:
    """The results of every seed of every run after each amount of experience, as CSV."""
    names = [
        *sweep.SHOWN,
        *dict.fromkeys(name for run in runs for name in run.measures),
        sweep.SPENT,
    ]
    rows = []
    for run in runs:
        for seed, course in run.courses.items():
            unknown = np.full(len(course.experience_s), np.nan)
            columns = (course.values.get(name, unknown) for name in names)
            table = zip(course.experience_s, *columns, strict=True)
            rows += [(run.name, seed, k, *values) for k, values in enumerate(table, start=1)]
    return _csv(("run", "seed", "trial", "experience_s", *names), rows)


def page(found: sweep.LineUp, rows: Sequence[sweep.Row], gains: Sequence[sweep.Row]) -> str:
    """All tables as one Markdown text."""
    runs, env = found.runs, found.runs[0].protocol.env
    parts = [
        f"# {' and '.join(run.name for run in runs)} on {env}",
        about(runs),
        solved_table(runs),
    ]
    cautions = [*found.left_out, *found.cautions]
    if cautions:
        parts.append("\n".join(f"- {sentence}" for sentence in cautions))
    parts += ["## After each amount of experience", LEGEND, *tables(rows, sweep.all_amounts(runs))]
    if len(runs) > 1:
        parts += ["## Differences of the same seeds", *difference_tables(runs, gains)]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def about(runs: Sequence[sweep.Run]) -> str:
    """Which runs these are."""
    cells = [
        (run.name, run.algo, run.preset, str(len(run.courses)), str(run.fresh)) for run in runs
    ]
    return sweep.markdown(("run", "algorithm", "preset", "seeds", "fresh rollouts a policy"), cells)


def solved_table(runs: Sequence[sweep.Run]) -> str:
    """How much experience it takes."""
    first = {run.name: _told(c.succeeded_s for c in run.courses.values()) for run in runs}
    often = {run.name: _told(c.solved_s for c in run.courses.values()) for run in runs}
    cells = [
        (run.name, *_until(first[run.name]), *_until(often[run.name]))
        for run in runs
        if first[run.name] or often[run.name]
    ]
    if not cells:
        return ""
    header = ("run", "first success [s]", "seeds", "solved [s]", "seeds")
    return (
        sweep.markdown(header, cells)
        + "\nExperience, median over seeds, and how many seeds get there. First success: behind "
        "the first policy whose test rollout succeeds; solved: behind the first that succeeds in "
        "90 % of its fresh rollouts; inf where half of the seeds have none."
    )


def _told(seconds: Iterable[float]) -> list[float]:
    return sorted(value for value in seconds if not math.isnan(value))


def _until(rising: Sequence[float]) -> tuple[str, str]:
    """The median, where half of the values may be infinite, and how many are not."""
    if not rising:
        return "", ""
    upper, lower = rising[len(rising) // 2], rising[(len(rising) - 1) // 2]
    return f"{(upper + lower) / 2:g}", f"{sum(map(math.isfinite, rising))} of {len(rising)}"


def tables(rows: Sequence[sweep.Row], amounts: Sequence[float]) -> list[str]:
    """A heading and a table for each measure that a run tells."""
    parts = []
    for measure, lines in _by_measure(rows):
        cells = [(line[0].run, _NAMES[line[0].statistic], *_along(amounts, line)) for line in lines]
        header = ("run", "over seeds", *(f"{amount:g} s" for amount in amounts))
        parts += [f"### {_upper(measure.title)}", sweep.markdown(header, cells)]
    return parts


def difference_tables(runs: Sequence[sweep.Run], gains: Sequence[sweep.Row]) -> list[str]:
    """A table for each measure: each pair of runs that have seeds and amounts in common."""
    parts = []
    for measure, lines in _by_measure(gains):
        told = [row.experience_s for line in lines for row in line]
        amounts = [
            a for a in sweep.all_amounts(runs) if any(sweep.same_amount(a, own) for own in told)
        ]
        cells = []
        for line in lines:
            seeds = str(max(row.estimate.seeds for row in line))
            pair = f"{line[0].run} minus {line[0].other}"
            cells.append((pair, seeds, *_along(amounts, line)))
        header = ("runs", "common seeds", *(f"{amount:g} s" for amount in amounts))
        title = f"{_upper(measure.title)}, {_NAMES[measure.statistics[0]]} of the differences"
        parts += [f"### {title}", sweep.markdown(header, cells)]
    return parts or ["No two runs have a seed and an amount of experience in common."]


def _by_measure(rows: Sequence[sweep.Row]) -> Iterator[tuple[sweep.Measure, list[list[sweep.Row]]]]:
    """The rows of each measure, in lines of which the rows differ in their amount alone."""
    for measure, of_it in groupby(rows, key=lambda row: row.measure):
        lines = groupby(of_it, key=lambda row: (row.run, row.other, row.statistic))
        yield measure, [list(line) for _, line in lines]


def _along(amounts: Sequence[float], line: Sequence[sweep.Row]) -> Iterator[str]:
    """A cell for each amount; blank where there is none."""
    for amount in amounts:
        at = (row for row in line if sweep.same_amount(row.experience_s, amount))
        found = next(at, None)
        yield "" if found is None else estimate_cell(found.estimate, found.measure)


def estimate_cell(found: sweep.Estimate | None, measure: sweep.Measure) -> str:
    """A value and its interval."""
    if found is None:
        return ""
    value = f"{found.value:.{measure.digits}f}"
    if found.low is None or found.high is None:
        return value
    return f"{value} ({found.low:.{measure.digits}f} to {found.high:.{measure.digits}f})"


def _cells(row: sweep.Row) -> tuple[object, ...]:
    about = row.measure.key, row.measure.unit, row.statistic, row.experience_s
    return *about, *vars(row.estimate).values()


def _csv(header: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    """Numbers read back equal; what is not told is empty, be it None or NaN."""
    return csv_bytes(header, (["" if value != value else value for value in row] for row in rows))


def _upper(text: str) -> str:
    return text[0].upper() + text[1:]


def write_curves(path: Path, runs: Sequence[sweep.Run], rows: Sequence[sweep.Row]) -> Path:
    """Learning curves, a panel a measure, with the intervals over seeds as bands."""
    panels = []
    for measure in sweep.measures(runs):
        curves = {}
        for place, run in enumerate(runs):
            wanted = run.name, measure, measure.statistics[0]
            mine = [r for r in rows if (r.run, r.measure, r.statistic) == wanted]
            found = [(r.experience_s, r.estimate) for r in mine]
            told = [(after, e.value, e.low, e.high) for after, e in found]
            if told:
                curves[place] = Curve(run.name, *np.array(told, dtype=float).T)
        if curves:
            label = measure.title if measure.statistics[0] == "mean" else f"{measure.title}, IQM"
            panels.append(partial(plot_curves, curves, label))
    return _write(path, panels, legend=True)


def write_seeds(path: Path, runs: Sequence[sweep.Run]) -> Path:
    """How the seeds are spread after most experience, a panel a measure."""
    common = sweep.common_amounts(runs)
    panels = []
    for measure in (measure for measure in sweep.measures(runs) if not measure.share):
        reached = {}
        for place, run in enumerate(runs):
            amount = common[-1] if common else float(run.amounts[-1])
            values = [measure.scale * v for v in run.at(amount, measure.key).values()]
            if values:
                reached[place] = f"{run.name}, {amount:g} s", values
        if reached:
            panels.append(partial(plot_seeds, reached, measure.title))
    return _write(path, panels)


def _write(path: Path, panels: Sequence[Callable[[Axes], object]], legend: bool = False) -> Path:
    """A picture of panels in two columns, the first with a legend."""
    axes = new_axes(len(panels))
    for ax, panel in zip(axes, panels, strict=True):
        panel(ax)
    if legend:
        add_legend(axes[0])
    return write_picture(path, axes[0])
