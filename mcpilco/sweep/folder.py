"""A sweep and its folder: a file a seed, so that a sweep goes on where it was stopped.

sweep.json         what all its seeds have in common
seeds/0007.json    the result of seed 7, written when it is complete
seeds/0007.txt     why seed 7 failed; gone when it has succeeded
summary.json       statistics over the seeds: rates, means and quartiles
table.md           the same as a table
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mcpilco.agent import find
from mcpilco.config import from_dict
from mcpilco.data import title_of
from mcpilco.files import require_own, write_bytes
from mcpilco.logbook import counting, measures_in, read_json, write_json
from mcpilco.sweep.engines import Engine, Failure, Job, LocalEngine, OnResult
from mcpilco.sweep.job import FORMAT, Settings, seed_job
from mcpilco.sweep.statistics import CONFIDENCE, mean, rate, spread
from mcpilco.typing import InputError, RunFolderError

SUMMARY_LEGEND = (
    "after: experience; success: of the one test rollout, with its "
    f"{CONFIDENCE:.0%} Wilson interval; p: mean success over fresh rollouts of each policy, mean "
    f"over seeds with its {CONFIDENCE:.0%} bootstrap interval; all else: median (quartiles) over "
    "seeds; CPU: of the trial."
)
"""the meaning of the columns of `table`"""

_SUMS = ("starts", "policy_steps", "cpu_s", "wall_s")
"""numbers of a trial that add up over a training"""
_SPREADS = ("return", "fresh_return", "predicted_cost", "real_cost", *_SUMS)


def summarise(
    results: Mapping[int, Mapping[str, Any]], failures: Mapping[int, str]
) -> dict[str, Any]:
    """Statistics over the seeds of a sweep, as JSON values.

    Returns:
        `trials`: statistics of each; `run`: of whole trainings; `solved`: share of the seeds of
        which any test rollout succeeded; `by_seed`: what is told of each; `machines`: where.
    """
    seeds = list(results.values())
    return {
        "seeds": sorted(results),
        "failed": {str(seed): why for seed, why in failures.items()},
        "trials": [
            _trial(rows) for rows in zip(*(result["trials"] for result in seeds), strict=True)
        ],
        "solved": rate(_solved(result) for result in seeds),
        "run": {
            key: spread(sum(row[key] for row in result["trials"]) for result in seeds)
            for key in _SUMS
        },
        "by_seed": {str(seed): _digest(result) for seed, result in results.items()},
        "machines": _machines(seeds),
    }


def summary_table(summary: Mapping[str, Any]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """The summary as a header and a row a trial; blank where the env does not report a number."""
    measures = measures_of(summary)
    titles = ("after [s]", "success [%]", "p [%]", "return", *map(title_of, measures), "CPU [s]")
    rows = [
        (
            f"{trial['experience_s']:g}",
            rate_cell(trial["success"]),
            mean_cell(trial["p"]),
            spread_cell(trial["return"], 1),
            *(spread_cell(trial.get(name), 2) for name in measures),
            spread_cell(trial["cpu_s"], 1),
        )
        for trial in summary["trials"]
    ]
    return titles, rows


def measures_of(summary: Mapping[str, Any]) -> list[str]:
    """The env's measures in a summary."""
    return measures_in(dict.fromkeys(name for trial in summary["trials"] for name in trial))


def conclusion(summary: Mapping[str, Any]) -> str:
    """A sentence on whole trainings."""
    count = len(summary["seeds"])
    cpu = spread_cell(summary["run"]["cpu_s"], 1) or "no"
    failed = ", ".join(f"seed {seed}" for seed in summary["failed"]) or "none"
    return f"Seeds: {count}; failed: {failed}; {cpu} CPU seconds a training."


def markdown(header: Sequence[str], cells: Iterable[Sequence[str]]) -> str:
    """A table."""
    lines = [header, ["---"] * len(header), *cells]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def rate_cell(found: Mapping[str, Any] | None, kind: str = "rate") -> str:
    """A rate and its interval [%], where it has one."""
    if found is None:
        return ""
    if found["low"] is None:
        return f"{100 * found[kind]:.1f}"
    return f"{100 * found[kind]:.1f} ({100 * found['low']:.0f}–{100 * found['high']:.0f})"


def mean_cell(found: Mapping[str, Any] | None) -> str:
    """A mean share and its interval [%]."""
    return rate_cell(found, "mean")


def spread_cell(found: Mapping[str, float] | None, digits: int) -> str:
    """A median and its quartiles."""
    if found is None:
        return ""
    median, q1, q3 = (f"{found[key]:.{digits}f}" for key in ("median", "q1", "q3"))
    return f"{median} ({q1}–{q3})"


def _trial(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    measures = measures_in(dict.fromkeys(name for row in rows for name in row))
    return {
        "trial": rows[0]["trial"],
        "experience_s": float(np.median([row["experience_s"] for row in rows])),
        "success": rate(row["success"] for row in rows),
        "p": mean(row["p"] for row in rows),
        **{key: spread(row.get(key) for row in rows) for key in (*_SPREADS, *measures)},
    }


def _solved(result: Mapping[str, Any]) -> bool | None:
    told = [row["success"] for row in result["trials"] if row["success"] is not None]
    return any(told) if told else None


def _digest(result: Mapping[str, Any]) -> dict[str, Any]:
    """The trials of a seed as lists, and the time of all of them."""
    digest = {key: [row[key] for row in result["trials"]] for key in ("success", "p", "return")}
    return {**digest, "cpu_s": round(sum(row["cpu_s"] for row in result["trials"]), 1)}


def _machines(seeds: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Each machine, with its versions, that a seed ran on; once."""
    found: list[dict[str, Any]] = []
    for result in seeds:
        machine = {**result["machine"], "versions": result["versions"]}
        if machine not in found:
            found.append(machine)
    return found


class SweepFolder:
    """Results on disk; what cannot be written raises RunFolderError."""

    def __init__(self, path: str | Path, settings: Settings) -> None:
        """A new folder, or the one in which a sweep with the same settings was begun.

        Raises:
            RunFolderError: it cannot be written, holds other settings or something else, or leads
                elsewhere.
        """
        self.path = Path(path)
        self._trials = settings.trials
        known = {"format": FORMAT, **settings.to_json()}
        about = self.path / "sweep.json"
        begun = about.is_file()
        require_own(self.path)
        if begun:
            _require_equal(self.path, _completed(read_json(about)), known)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if not begun and any(self.path.iterdir()):
                raise RunFolderError(
                    f"{self.path} is not empty and holds no sweep; name a new folder."
                )
            (self.path / "seeds").mkdir(exist_ok=True)  # git keeps no empty folder
        except OSError as error:
            raise RunFolderError(
                f"{self.path} cannot be written ({error.strerror or error}); choose another folder."
            ) from error
        if not begun:
            write_json(about, known)

    def results(self) -> dict[int, dict[str, Any]]:
        """The complete results, by seed; a damaged file counts as missing."""
        found = {}
        for path in (self.path / "seeds").glob("*.json"):
            with contextlib.suppress(RunFolderError, KeyError, TypeError):
                result = read_json(path)
                if result["format"] == FORMAT and len(result["trials"]) == self._trials:
                    found[int(result["seed"])] = result
        return dict(sorted(found.items()))

    def failures(self) -> dict[int, str]:
        """Why the seeds failed that have no result, in a line each."""
        paths, done = sorted((self.path / "seeds").glob("*.txt")), self.results()
        lines = {int(path.stem): path.read_text(encoding="utf-8").split("\n")[0] for path in paths}
        return {seed: line for seed, line in lines.items() if seed not in done}

    def write(self, seed: int, outcome: dict[str, Any] | Failure) -> None:
        """Keep the outcome of a seed."""
        failure = self.path / "seeds" / f"{seed:04d}.txt"
        if isinstance(outcome, Failure):
            write_bytes(failure, f"{outcome.reason}\n\n{outcome.details}".encode())
            return
        write_json(failure.with_suffix(".json"), outcome)
        failure.unlink(missing_ok=True)


def _completed(there: dict[str, Any]) -> dict[str, Any]:
    """Settings of an earlier version, with the entries that came since at their defaults."""
    try:
        settings = from_dict(Settings, {k: v for k, v in there.items() if k != "format"})
        kind = find(settings.algo)
        config = from_dict(kind.config_type, settings.config)
        settings = dataclasses.replace(settings, config=config)
    except InputError:
        return there
    return {"format": there.get("format"), **settings.to_json()}


def _require_equal(path: Path, there: dict[str, Any], here: dict[str, Any]) -> None:
    differ = [key for key in here if there.get(key) != here[key]]
    if differ:
        named = ", ".join(
            f"{key} was {_short(there, key)}, now {_short(here, key)}" for key in differ
        )
        raise RunFolderError(
            f"{path} holds a sweep with other settings: {named}; name another folder."
        )


def _short(settings: dict[str, Any], key: str) -> str:
    value = settings.get(key)
    return "another" if isinstance(value, dict) else repr(value)


_SPEED_PERIOD_S = 3600.0  # seeds end rarely: the time left is estimated from the last hour


def parse_seeds(text: str) -> Sequence[int]:
    """The seeds that `0:30`, `3,5,7` or `0:30,40` stand for, in order, each once.

    Raises:
        InputError: it is none of these, or holds a negative number or an empty range.
    """
    seeds: set[int] = set()
    try:
        for part in text.split(","):
            first, colon, end = part.partition(":")
            some = range(int(first), int(end)) if colon else (int(first),)
            if not some or some[0] < 0 or some[-1] >= 2**32:
                raise ValueError(part)
            seeds.update(some)
    except ValueError as error:
        raise InputError(
            "--seeds must be like 0:30, which are 0 to 29, like 3,5,7, or both, as 0:30,40, "
            f"got {text!r}."
        ) from error
    return sorted(seeds)


def sweep(
    settings: Settings,
    seeds: Iterable[int],
    path: str | Path,
    engine: Engine | None = None,
    on_result: OnResult | None = None,
    make_job: Callable[[Any, int], Job] = seed_job,
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
        table = markdown(*summary_table(summary))
        text = f"{table}\n{SUMMARY_LEGEND}\n\n{conclusion(summary)}\n"
        write_json(folder.path / "summary.json", summary)
        write_bytes(folder.path / "table.md", text.encode())
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
