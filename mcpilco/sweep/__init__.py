"""Many seeds at once: the same training from each, and what its result owes to chance.

settings = Settings("envs:mcpilco/CartPoleSwingUp-v0")
summary = sweep(settings, range(30), "runs/out/sweep", LocalEngine())
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from mcpilco.sweep.engines import Engine, Failure, Job, LocalEngine, OnResult, RayEngine
from mcpilco.sweep.folder import SweepFolder
from mcpilco.sweep.job import SeedJob, Settings
from mcpilco.sweep.summary import LEGEND, conclusion, markdown, summarise, table

__all__ = [
    "Engine",
    "Failure",
    "LocalEngine",
    "RayEngine",
    "Settings",
    "SweepFolder",
    "sweep",
]


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
        text = markdown(*table(summary))
        folder.write_summary(summary, f"{text}\n{LEGEND}\n\n{conclusion(summary)}\n")
    return summary
