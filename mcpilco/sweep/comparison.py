"""Runs to lay beside one another: the results of each seed after each amount of experience.

found = line_up([Path("runs/out/a"), Path("runs/out/b")])
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from mcpilco.logbook import RunFolder, measures_in, read_json
from mcpilco.sweep.job import FORMAT
from mcpilco.typing import RunFolderError

SHOWN = ("success", "p", "return", "fresh_return")
"""numbers of a trial's policy, by the names that a sweep gives them, beside the env's measures"""
SPENT = "cpu_s"
"""processor time; of a trial in a sweep, here of all trials up to it"""
_SOLVED = 0.9
"""share of fresh rollouts in which a policy succeeds that solves the task, at least [-]"""


@dataclass(frozen=True)
class Protocol:
    """Env and lengths of episodes, which must be equal for two runs to be judged alike."""

    env: str
    """Gymnasium id"""
    env_kwargs: Mapping[str, Any]
    """keywords it is made with; success rule, noise and time limit are among them"""
    horizon: int | None
    """steps of an episode; None: the env's time limit"""
    fresh_horizon: int | None = None
    """steps of a fresh rollout; None: those of the training"""

    def differences(self, other: Protocol) -> str:
        """A list of what differs; empty where all is equal."""
        here, there = vars(self), vars(other)
        return ", ".join(
            f"{name} {here[name]!r}, not {there[name]!r}"
            for name in here
            if here[name] != there[name]
        )


@dataclass(frozen=True)
class Course:
    """How one seed went, at each of T amounts of experience."""

    experience_s: Float[np.ndarray, " T"]
    """duration of the data behind each policy [s]"""
    values: Mapping[str, Float[np.ndarray, " T"]]
    """of each name in `SHOWN`, of the env's measures and of `SPENT`; NaN where it is not known"""

    @property
    def succeeded_s(self) -> float:
        """Experience behind the first policy whose test rollout succeeds [s].

        inf where none does, NaN where nobody tells.
        """
        return self._first(self.values["success"], 1.0)

    @property
    def solved_s(self) -> float:
        """Experience behind the first policy that succeeds in 90 % of its fresh rollouts [s].

        inf where none does, NaN where there are none.
        """
        return self._first(self.values["p"], _SOLVED)

    def _first(self, shares: Float[np.ndarray, " T"], least: float) -> float:
        if np.isnan(shares).all():
            return math.nan
        reached = self.experience_s[shares >= least]
        return float(reached[0]) if len(reached) else math.inf


@dataclass(frozen=True)
class Run:
    """One row of a comparison: the same training from one or many seeds."""

    name: str
    """what it is called"""
    algo: str
    preset: str
    protocol: Protocol
    fresh: int
    """fresh rollouts that each policy was judged by; 0: none"""
    courses: Mapping[int, Course]
    """of each seed"""
    machines: frozenset[str] = frozenset()
    """processors that it ran on, where known"""
    problems: tuple[str, ...] = ()
    """a sentence on each seed that is missing"""
    config: str = ""
    """the agent's numbers as text; equal for runs that differ in their seed only"""
    task: str | None = None
    """file of what the agent was told of the env; None: what the env shows, or a guess"""

    @property
    def measures(self) -> list[str]:
        """Names of the measures that the env reports, as `time_up_s`."""
        return measures_in(dict.fromkeys(name for c in self.courses.values() for name in c.values))

    @property
    def amounts(self) -> Float[np.ndarray, " T"]:
        """Experience behind each policy, median over seeds [s]."""
        each = [course.experience_s for course in self.courses.values()]
        trials = range(max(map(len, each)))
        return np.array([np.median([one[k] for one in each if k < len(one)]) for k in trials])

    def at(self, amount: float, measure: str) -> dict[int, float]:
        """A measure of each seed after an amount of experience that is one of `amounts`."""
        k = int(np.argmin(np.abs(self.amounts - amount)))
        reached = {s: c.values[measure] for s, c in self.courses.items() if measure in c.values}
        told = {s: float(v[k]) for s, v in reached.items() if k < len(v)}
        return {seed: value for seed, value in told.items() if math.isfinite(value)}


def read_run(path: Path) -> Run:
    """The run in a folder of `mcpilco sweep` or of `mcpilco train`.

    Raises:
        RunFolderError: it is neither, is damaged, or holds no finished trial.
    """
    if (path / "sweep.json").is_file():
        run = _read_sweep(path)
    elif (path / "config.json").is_file():
        run = _read_training(path)
    else:
        inside = sorted(p.parent.name for p in path.glob("*/sweep.json")) if path.is_dir() else []
        remedy = "name a folder that `mcpilco sweep` or `mcpilco train` wrote"
        if inside:
            remedy = f"name its folders, which do: {', '.join(inside)}"
        raise RunFolderError(
            f"{path} holds neither a sweep (sweep.json) nor a run (config.json); {remedy}."
        )
    if not run.courses:
        why = " ".join(run.problems)
        raise RunFolderError(f"{path} holds no finished trial yet; train until one ends. {why}")
    return run


def _read_sweep(path: Path) -> Run:
    about = read_json(path / "sweep.json")
    if about.get("format") != FORMAT:
        raise RunFolderError(
            f"{path / 'sweep.json'} has format {about.get('format')!r}, this mcpilco reads "
            f"{FORMAT}; install the mcpilco that wrote it, or run the sweep anew."
        )
    courses, problems, machines = {}, [], set()
    for file in sorted((path / "seeds").glob("*.json")):
        try:
            result = read_json(file)
            courses[int(result["seed"])] = _course(result["trials"])
            machines.add(str(result["machine"]["cpu"]))
        except (RunFolderError, KeyError, TypeError, ValueError, IndexError) as error:
            problems.append(f"{file} is left out, for it is damaged ({error}).")
    for file in sorted((path / "seeds").glob("*.txt")):
        if not file.with_suffix(".json").exists():
            why = file.read_text(encoding="utf-8", errors="replace").partition("\n")[0]
            problems.append(f"{path}: seed {file.stem.lstrip('0') or '0'} broke off: {why}")
    return _run(path, about, courses, problems, machines)


def _read_training(path: Path) -> Run:
    run = RunFolder.open(path)
    rows = [dict(row) for row in run.metrics()]
    problems = []
    for row in rows:
        try:
            row["return"] = float(run.read_arrays(row["trial"], "rollout")["rewards"].sum())
        except (RunFolderError, KeyError) as error:
            problems.append(f"Trial {row['trial']} of {path} tells no return: {error}")
    courses = {run.config["seed"]: _course(rows)} if rows else {}
    return _run(path, {"fresh": 0, **run.config}, courses, problems, set())


def _run(
    path: Path,
    about: Mapping[str, Any],
    courses: Mapping[int, Course],
    problems: Sequence[str],
    machines: Iterable[str],
) -> Run:
    try:
        config = about["config"]
        protocol = Protocol(
            env=about["env"].rpartition(":")[2],
            env_kwargs=about["env_kwargs"],
            horizon=config.get("horizon"),
            fresh_horizon=about.get("fresh_horizon"),
        )
        return Run(
            name=path.resolve().name,
            algo=about.get("algo", "mcpilco").rpartition(":")[2],
            preset=about["preset"],
            protocol=protocol,
            fresh=int(about["fresh"]),
            courses=courses,
            machines=frozenset(machines),
            problems=tuple(problems),
            config=json.dumps(config, sort_keys=True),
            task=about.get("task"),
        )
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise RunFolderError(
            f"{path} is damaged: its setting lacks {error}; restore it from a copy."
        ) from error


def _course(rows: Sequence[Mapping[str, Any]]) -> Course:
    """Of the trials of a seed, at least one."""
    if not rows:
        raise ValueError("there is no trial")
    names = [*SHOWN, *measures_in(dict.fromkeys(name for row in rows for name in row))]
    values = {name: np.array([row.get(name) for row in rows], dtype=float) for name in names}
    values[SPENT] = np.cumsum([float(row[SPENT]) for row in rows])
    return Course(np.array([float(row["experience_s"]) for row in rows]), values)


# Runs that are judged alike -----------------------------------------------------------------------


@dataclass(frozen=True)
class LineUp:
    """Runs that can be compared."""

    runs: tuple[Run, ...]
    """at least one, in the order named"""
    left_out: tuple[str, ...]
    """a sentence on each folder that is not among them"""

    @property
    def cautions(self) -> list[str]:
        """Sentences on what limits the comparison."""
        found = [problem for run in self.runs for problem in run.problems]
        fresh = sorted({run.fresh for run in self.runs if run.fresh})
        if len(fresh) > 1:
            counts = ", ".join(map(str, fresh))
            found.append(f"p is of different numbers of fresh rollouts: {counts}.")
        tasks = {run.name: run.task for run in self.runs}
        if len(set(tasks.values())) > 1:
            told = ", ".join(f"{name}: {task or 'by the env'}" for name, task in tasks.items())
            found.append(
                f"The agents were given different tasks; all are judged by the env's: {told}."
            )
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
        elif (place := _twin(run, read)) is not None:
            where, there = read[place]
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


def _twin(run: Run, read: Sequence[tuple[Path, Run]]) -> int | None:
    """The place of a single training of the same setting, where this is one too."""

    def setting(one: Run) -> tuple[str | int | None, ...]:
        return one.fresh, one.algo, one.preset, one.config, one.task

    twins = (place for place, (_, other) in enumerate(read) if setting(other) == setting(run))
    return None if run.fresh else next(twins, None)


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
