"""The same training from many seeds: which seeds, where they run, how far they are."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from mcpilco.logbook import counting
from mcpilco.sweep.engines import Engine, Failure, Job, LocalEngine, OnResult
from mcpilco.sweep.folder import SweepFolder
from mcpilco.sweep.job import SeedJob, Settings
from mcpilco.sweep.summary import SUMMARY_LEGEND, conclusion, markdown, summarise, summary_table
from mcpilco.typing import InputError

_SPEED_PERIOD_S = 3600.0  # seeds end rarely: the time left is estimated from the last hour


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


def sweep(
    settings: Settings,
    seeds: Iterable[int],
    path: str | Path,
    engine: Engine | None = None,
    on_result: OnResult | None = None,
    make_job: Callable[[Any, int], Job] = SeedJob,
) -> dict[str, Any]:
    """Train from each seed that the folder has no result of, and return the summary of all it has.

    Called again it goes on; a seed that failed is tried again.

    Args:
        settings: what the seeds have in common.
        seeds: seeds, none negative.
        path: folder of the sweep, new or begun with the same settings.
        engine: where the seeds run; by default on this machine, one a core.
        on_result: told each seed that ends in this call, with its result or `Failure`.
        make_job: what trains one seed of these settings, and returns a result as `run_seed` does.

    Raises:
        RunFolderError: the folder cannot be written, or holds something else.
    """
    folder = SweepFolder(path, settings)
    done = folder.results()
    jobs = {seed: make_job(settings, seed) for seed in seeds if seed not in done}

    def keep(seed: int, outcome: Any) -> None:
        folder.write(seed, outcome)
        if on_result is not None:
            on_result(seed, outcome)

    try:
        (engine or LocalEngine()).run(jobs, keep)
    finally:  # also when it is interrupted
        summary = summarise(folder.results(), folder.failures())
        text = markdown(*summary_table(summary))
        folder.write_summary(summary, f"{text}\n{SUMMARY_LEGEND}\n\n{conclusion(summary)}\n")
    return summary


@contextlib.contextmanager
def sweep_progress(seeds: int, done: int, quiet: bool) -> Iterator[Any]:
    """A callback for `sweep` that prints a line for each seed, above a bar on a terminal."""
    with counting("seeds", seeds, done, quiet, _SPEED_PERIOD_S) as show:
        yield lambda seed, outcome: show(_line(seed, outcome))


def _line(seed: int, outcome: Any) -> str:
    if isinstance(outcome, Failure):
        return f"seed {seed} failed: {outcome.reason}"
    trials = outcome["trials"]
    words = {True: "yes", False: "no", None: "-"}
    success = " ".join(words[row["success"]] for row in trials)
    returns = " ".join(f"{row['return']:.1f}" for row in trials if row["return"] is not None)
    cpu = sum(row["cpu_s"] for row in trials)
    return f"seed {seed}: success {success}, return {returns}, {cpu:.1f} CPU s"
