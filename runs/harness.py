"""The parts that runs share: seeds are trained, results kept as JSON, and tables put into READMEs.

A run is one claim: `python runs/<claim>/run.py` takes seeds, keeps a file of results for each, and
rewrites the README of its folder between two marked lines from all results that are there.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from all_tables import table_of
from evidence import Stamp, stamp
from threadpoolctl import threadpool_limits

import baselines  # noqa: F401  registers its algorithms
from mcpilco import sweep as many
from mcpilco.agent import find, preset_numbers
from mcpilco.config import Config
from mcpilco.data import title_of
from mcpilco.files import write_bytes
from mcpilco.logbook import read_json
from mcpilco.sweep import (
    OnResult,
    Settings,
    SweepFolder,
    markdown,
    mean_cell,
    measures_of,
    parse_seeds,
    rate_cell,
    seed_job,
    spread_cell,
    sweep_progress,
)
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


__all__ = [
    "BEGIN",
    "END",
    "broken_off",
    "code_of",
    "code_that_made",
    "costs",
    "failures",
    "fill",
    "folder",
    "hasty",
    "keep",
    "kept",
    "machines",
    "marks",
    "once",
    "outcomes",
    "parse_seeds",
    "places",
    "preset_settings",
    "read_summaries",
    "swept",
    "use_one_thread",
    "write_picture",
]


def use_one_thread() -> None:
    """Keep torch and BLAS to one thread: runs share a machine, and last digits depend on it."""
    torch.set_num_threads(1)
    threadpool_limits(1)


# Seeds --------------------------------------------------------------------------------------------


def folder(here: Path, out: Path | None, quick: bool) -> Path:
    """The folder of results/ and README.md: the one asked for, else that of the run.

    Args:
        here: folder of the run.
        out: asked for.
        quick: whether the run only shows that it works, and must not touch its own folder.
    """
    return out or (Path("runs/out") / here.name if quick else here)


def hasty(config: Config) -> Config:
    """The configuration with a search that takes no time, and finds nothing."""
    search = replace(config.search, particles=8, steps=(5,), restarts=(0,), evaluation_particles=8)
    policy = replace(config.policy, bases=10)
    return replace(config, policy=policy, search=search)


def preset_settings(env: str, algo: str, preset: str, trials: int, fresh: int = 100) -> Settings:
    """The settings of a sweep with a preset, as `mcpilco sweep` makes them.

    Args:
        env: id of an env of this project.
        algo: name of an algorithm of this project.
        preset: of its presets.
        trials: policies to learn.
        fresh: rollouts that each is judged by.
    """
    config, env_kwargs = preset_numbers(find(algo), preset, env)
    algo = algo if algo == "mcpilco" else f"baselines:{algo}"
    return Settings(f"envs:{env}", env_kwargs, preset, config, trials, fresh, algo=algo)


def swept(
    settings: Any,
    seeds: Sequence[int],
    path: Path,
    run: str,
    workers: int | None = None,
    then: OnResult | None = None,
    make_job: Callable[[Any, int], Any] = seed_job,
) -> dict[str, Any]:
    """Train the seeds that are missing, with a line for each; the summary of all.

    Args:
        settings: of the sweep.
        seeds: asked for.
        path: folder of their results.
        run: folder of the run, see `evidence`.
        workers: processes at a time; None: one a core.
        then: called with each seed that ends, and its result or `Failure`.
        make_job: what trains one seed of these settings.
    """
    done = SweepFolder(path, settings).results().keys() & set(seeds)
    with sweep_progress(len(seeds), len(done), quiet=False) as show:

        def on_result(seed: int, outcome: Any) -> None:
            show(seed, outcome)
            if then is not None:
                then(seed, outcome)

        engine = many.LocalEngine(workers)
        job = partial(_stamped_job, make_job, path / "seeds", run)
        return many.sweep(settings, seeds, path, engine, on_result, job)


def _stamped_job(
    make_job: Callable[[Any, int], Any], results: Path, run: str, settings: Any, seed: int
) -> partial[dict[str, Any]]:
    path = results / f"{seed:04d}.json"
    return partial(_stamped, make_job(settings, seed), stamp(table_of(run, path)), path)


def _stamped(job: Callable[[], dict[str, Any]], by: Stamp, path: Path) -> dict[str, Any]:
    return by.on(job(), path)


def code_of(summary: Mapping[str, Any], seeds: Sequence[int]) -> int:
    """The exit code of a run: 1 where one of its seeds failed."""
    return int(any(str(seed) in summary["failed"] for seed in seeds))


def keep(path: Path, found: Mapping[str, Any], run: str, continued: bool = False) -> None:
    """Write a result as JSON, with the code that made it and its seed's role; its folder is made.

    Args:
        path: of its file.
        found: the result.
        run: folder of the run, whose tables `evidence` lists.
        continued: whether it holds what the file that is there held.

    Raises:
        LookupError: the run has no such table.
        RunFolderError: the file cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    result = stamp(table_of(run, path)).on(found, path, continued)
    write_bytes(path, json.dumps(result, indent=1).encode())


def once(
    path: Path, run: str, make: Callable[..., Mapping[str, Any]], *given: Any
) -> Mapping[str, Any] | None:
    """Make a result of what is given and keep it, as `keep` does; None if it is there already."""
    if path.exists():
        return None
    found = make(*given)
    keep(path, found, run)
    return found


def kept(results: Path) -> list[dict[str, Any]]:
    """The results in a folder, in the order of their names.

    Raises:
        RunFolderError: a file cannot be read.
    """
    return [read_json(path) for path in sorted(results.glob("*.json"))]


# The page -----------------------------------------------------------------------------------------


def marks(name: str, by: str = "run.py") -> tuple[str, str]:
    """The lines between which a part of a page is rewritten, by its name and its command."""
    return f"<!-- {name}: written by {by} -->", f"<!-- end of {name} -->"


BEGIN, END = marks("results")
"""those of the part that most pages have"""


def read_summaries(results: Path, names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The summary of each sweep that has one, by name.

    Args:
        results: folder of the sweeps.
        names: of the sweeps' folders, in the order of the page.

    Raises:
        RunFolderError: a summary cannot be read.
    """
    paths = {name: results / name / "summary.json" for name in names}
    return {name: read_json(path) for name, path in paths.items() if path.exists()}


def write_picture(path: Path, figure: Figure, dpi: int = 110) -> None:
    """Draw a figure into a PNG file; its folder is made.

    Raises:
        RunFolderError: the file cannot be written.
    """
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, content.getvalue())


def fill(
    page: Path,
    parts: Sequence[str],
    template: Path | None = None,
    name: str = "results",
    by: str = "run.py",
) -> None:
    """Put these parts between the marked lines of a page; all else in it stays.

    Args:
        page: a Markdown file.
        parts: paragraphs, headings and tables; empty ones are left out.
        template: what the page begins as where there is none.
        name: which of its marked parts.
        by: the command that its first line names.

    Raises:
        InputError: the page has not both lines, once each and in order.
        RunFolderError: the page cannot be written.
    """
    page.parent.mkdir(parents=True, exist_ok=True)
    begun = page if template is None or page.exists() else template
    text = begun.read_text(encoding="utf-8")
    begin, end = marks(name, by)
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise InputError(
            f"{begun} must hold the lines {begin} and {end}, once each, in this order."
        )
    head, tail = text.split(begin)[0], text.split(end)[1]
    results = "\n\n".join(part.strip() for part in parts if part)
    write_bytes(page, f"{head}{begin}\n\n{results}\n\n{end}{tail}".encode())


def outcomes(summary: Mapping[str, Any]) -> str:
    """A table of what each amount of experience gave; a row that the env does not tell is left out.

    Args:
        summary: of `mcpilco.sweep.folder.summarise`.
    """
    rows: dict[str, Callable[[Mapping[str, Any]], str]] = {
        "success of one rollout a policy [%]": lambda trial: rate_cell(trial["success"]),
        "p over fresh rollouts of each policy [%]": lambda trial: mean_cell(trial["p"]),
        **{title_of(name): partial(_spread_of, name) for name in measures_of(summary)},
        "predicted cost [-]": lambda trial: spread_cell(trial["predicted_cost"], 1),
        "real cost [-]": lambda trial: spread_cell(trial["real_cost"], 1),
    }
    trials = summary["trials"]
    header = ["after", *(f"{trial['experience_s']:g} s" for trial in trials)]
    cells = [(name, *map(cell, trials)) for name, cell in rows.items()]
    return (
        f"{markdown(header, [row for row in cells if any(row[1:])])}\n"
        "In brackets: 95 % intervals for success and p, Wilson's and the bootstrap's over seeds; "
        "for all else the quartiles, beside the median. Costs are sums over an episode."
    )


def _spread_of(name: str, trial: Mapping[str, Any]) -> str:
    return spread_cell(trial.get(name), 2)


def costs(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """A table of what a training takes, a row a preset.

    Args:
        summaries: of `mcpilco.sweep.folder.summarise`, by preset.
    """
    rows = [
        (
            f"`{preset}`",
            str(len(summary["trials"])),
            spread_cell(summary["run"]["cpu_s"], 1),
            spread_cell(summary["run"]["wall_s"], 1),
            spread_cell(summary["run"]["policy_steps"], 0),
            spread_cell(summary["run"]["starts"], 0),
        )
        for preset, summary in summaries.items()
        if summary["trials"]
    ]
    header = ("preset", "trials", "CPU [s]", "wall [s]", "policy steps", "starts")
    return (
        "### A whole training: median (quartiles)\n\n"
        f"{markdown(header, rows)}\n"
        "One thread a process. Without the import of the packages and the judging of the policies "
        "on fresh rollouts; with the loading of the compiled code in the first trial."
    )


def failures(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Which seeds' last policy failed its test rollout, and which trainings broke off."""
    lines = []
    for preset, summary in summaries.items():
        lost = [
            f"{seed} (p {found['p'][-1]:.2f})"
            for seed, found in summary["by_seed"].items()
            if not found["success"][-1]
        ]
        lines.append(f"- `{preset}`, last test rollout: {', '.join(lost) or 'none'}")
        lines += broken_off({preset: summary})
    return "### Seeds that failed\n\n" + "\n".join(lines)


def broken_off(summaries: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """A line for each training that broke off: whose, and why."""
    return [
        f"- `{preset}`, seed {seed} broke off: {why}"
        for preset, summary in summaries.items()
        for seed, why in summary["failed"].items()
    ]


def machines(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    """Where the seeds ran, and with which versions."""
    found: dict[str, list[str]] = {}
    for preset, summary in summaries.items():
        for machine in summary["machines"]:
            versions = ", ".join(f"{name} {value}" for name, value in machine["versions"].items())
            line = f"{machine['cpu']}, {machine['cores']} cores; {versions}"
            found.setdefault(line, []).append(f"`{preset}`")
    lines = [f"- {', '.join(presets)}: {line}" for line, presets in found.items()]
    return "### Machine\n\n" + "\n".join(lines)


def code_that_made(result: Mapping[str, Any]) -> str:
    """The code that made a result, as a page calls it."""
    made = result.get("made", {})
    if made.get("digest"):
        return f"code of digest `{made['digest']}`"
    if "method" in result:  # before all code was digested
        return f"code of which `mcpilco.gap` had the digest `{result['method']}`"
    return "code of several versions" if made else "code that is not recorded"


def places(results: Iterable[Mapping[str, Any]], more: str = "") -> str:
    """Where results that are no seeds of a sweep were measured.

    Args:
        results: each with its `machine`, as `mcpilco.sweep.job.machine` tells it.
        more: what to add to each line.
    """
    machines = (result["machine"] for result in results)
    lines = sorted({f"- {m['cpu']}, {m['cores']} cores{more}" for m in machines})
    return "### Machine\n\n" + "\n".join(lines)
