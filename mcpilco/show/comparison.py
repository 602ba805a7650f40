"""A comparison of runs as files: tables and pictures."""

from __future__ import annotations

from pathlib import Path

from mcpilco.files import write_bytes
from mcpilco.show.comparison_pictures import write_curves, write_seeds
from mcpilco.sweep.comparison import LineUp, tables
from mcpilco.sweep.comparison.statistics import differences, estimates
from mcpilco.typing import RunFolderError


def write_comparison(found: LineUp, out: Path) -> list[Path]:
    """Write tables and pictures; returns their paths, that of the page first.

    comparison.md      all tables
    comparison.csv     statistics over seeds: a row a run, measure, statistic and amount
    differences.csv    the same of differences between two runs, seed by seed
    seeds.csv          what each seed reached
    curves.png         learning curves
    seeds.png          how the seeds are spread

    Args:
        found: the runs.
        out: folder; what an earlier comparison left there is replaced.

    Raises:
        InputError: matplotlib is missing.
        RunFolderError: a file cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunFolderError(
            f"{out} cannot be written ({error.strerror or error}); choose another folder."
        ) from error
    rows, gains = estimates(found.runs), differences(found.runs)
    texts = {
        "comparison.md": tables.page(found, rows, gains),
        "comparison.csv": tables.estimates_csv(rows),
        "differences.csv": tables.differences_csv(gains),
        "seeds.csv": tables.seeds_csv(found.runs),
    }
    written = [write_bytes(out / name, text.encode()) for name, text in texts.items()]
    written.append(write_curves(out / "curves.png", found.runs, rows))
    written.append(write_seeds(out / "seeds.png", found.runs))
    return written
