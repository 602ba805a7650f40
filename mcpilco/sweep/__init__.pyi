from .engines import Engine, Failure, LocalEngine, OnResult, RayEngine
from .folder import SweepFolder
from .fresh import Act, FreshEpisodes, outcomes_one_by_one
from .job import SeedJob, Settings, machine, one_thread, run_seed
from .seeds import parse_seeds, sweep, sweep_progress
from .summary import (
    bootstrapped,
    markdown,
    mean,
    mean_cell,
    measures_of,
    rate,
    rate_cell,
    spread,
    spread_cell,
    summarise,
)

__all__ = [
    "Act",
    "Engine",
    "Failure",
    "FreshEpisodes",
    "LocalEngine",
    "OnResult",
    "RayEngine",
    "SeedJob",
    "Settings",
    "SweepFolder",
    "bootstrapped",
    "machine",
    "markdown",
    "mean",
    "mean_cell",
    "measures_of",
    "one_thread",
    "outcomes_one_by_one",
    "parse_seeds",
    "rate",
    "rate_cell",
    "run_seed",
    "spread",
    "spread_cell",
    "summarise",
    "sweep",
    "sweep_progress",
]
