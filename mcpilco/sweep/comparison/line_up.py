"""Which runs stand in one table: those that are judged alike, each under a name of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mcpilco.sweep.comparison.runs import Run, read_run
from mcpilco.typing import RunFolderError


@dataclass(frozen=True)
class LineUp:
    """Runs that can be compared."""

    runs: tuple[Run, ...]
    """at least one, in the order named"""
    left_out: tuple[str, ...]
    """a sentence on each folder that is not among them"""

    @property
    def cautions(self) -> list[str]:
        """What a reader of the tables must know."""
        found = [problem for run in self.runs for problem in run.problems]
        fresh = sorted({run.fresh for run in self.runs if run.fresh})
        if len(fresh) > 1:
            counts = ", ".join(map(str, fresh))
            found.append(f"p is of different numbers of fresh rollouts: {counts}.")
        tasks = {run.name: run.task for run in self.runs}
        if len(set(tasks.values())) > 1:
            told = ", ".join(f"{name}: {task or 'by the env'}" for name, task in tasks.items())
            found.append(f"The agents were told different tasks, judged all by the env's: {told}.")
        machines = sorted(set().union(*(run.machines for run in self.runs)))
        if len(machines) > 1:
            found.append(f"CPU seconds are of different machines: {', '.join(machines)}.")
        return found


def line_up(paths: Sequence[Path]) -> LineUp:
    """The runs in these folders; those that cannot stand beside the first are left out.

    Run folders that differ in nothing but their seed are one run.

    Raises:
        RunFolderError: no folder can be read; the sentence says why for each.
    """
    read: list[tuple[Path, Run]] = []
    left_out: list[str] = []
    for path in {path.resolve(): path for path in paths}.values():
        try:
            run = read_run(path)
        except RunFolderError as error:
            left_out.append(f"left out: {error}")
            continue
        differ = run.protocol.differences(read[0][1].protocol) if read else ""
        if differ:
            first = read[0][0]
            left_out.append(f"left out: {path} is judged otherwise than {first}: {differ}.")
        elif twin := _twin(run, read):
            place, (where, there) = twin
            both = sorted(run.courses.keys() & there.courses.keys())
            if both:
                left_out.append(
                    f"left out: {path} has the same setting and seed {both[0]} as {where}."
                )
            else:
                read[place] = where, _merged(there, run)
        else:
            read.append((path, run))
    if not read:
        raise RunFolderError(" ".join(left_out) or "Nothing to compare; name a folder.")
    return LineUp(_named(read), tuple(left_out))


def _twin(run: Run, read: Sequence[tuple[Path, Run]]) -> tuple[int, tuple[Path, Run]] | None:
    """A single training of the same setting, where this is one too."""
    if run.fresh:
        return None
    setting = run.algo, run.preset, run.config, run.task
    for place, (path, other) in enumerate(read):
        if not other.fresh and (other.algo, other.preset, other.config, other.task) == setting:
            return place, (path, other)
    return None


def _merged(run: Run, other: Run) -> Run:
    courses = dict(sorted({**run.courses, **other.courses}.items()))
    name = run.algo if run.preset == "default" else f"{run.algo}-{run.preset}"
    problems = run.problems + other.problems
    return dataclasses.replace(run, name=name, courses=courses, problems=problems)


def _named(read: Sequence[tuple[Path, Run]]) -> tuple[Run, ...]:
    """The runs, under as much of their paths as tells them apart."""
    names = [run.name for _, run in read]
    unclear = {name for name in names if names.count(name) > 1}
    longer = []
    for path, run in read:
        parts = path.resolve().parts
        same = [p.resolve().parts for p, other in read if other.name == run.name and p != path]
        depth = next(
            (k for k in range(1, len(parts)) if all(parts[-k:] != other[-k:] for other in same)), 1
        )
        name = "/".join(parts[-depth:]) if run.name in unclear else run.name
        longer.append(dataclasses.replace(run, name=name))
    return tuple(longer)
