"""Make samples of the tables again that are not of today's code: where they are equal, all stands.

    python runs/again.py                               # two results of each code of each such table
    python runs/again.py --runs gip limits --sample 1
    python runs/again.py --runs limits --beside        # by the code before as well, in this place
    python runs/again.py --runs limits --of 35d58c78138f  # results of this code alone

Most changes of code change no result. Of each code that made results of a table, a sample is made
again by the code that is here, in another folder, with the command that made it. Where all of it is
equal to six digits, but for times, `again.json` in the folder of the run says so, and `make
stale` calls these results confirmed, for as long as the code stays as it is. Where it is not, the
first difference is told: the table has to be made afresh.

Processors round differently, and where policies are learned that grows. With `--beside`, a result
that differs from the stored one is made by the code before too, from a checkout of the commit that
the result names or that stored it, whichever has the digest, and the two are compared.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tyro

sys.path.append(str(Path(__file__).parent))

from all_tables import TABLES, Table, named
from evidence import SAMPLES, confirmed_by, read_made, read_samples, state_of
from provenance import COMMIT, ROOT, RUNS, git

from mcpilco.files import write_bytes
from mcpilco.sweep import machine

ERRORS = "errors.txt"
"""file of what a command said while it made results"""
_TIMES = ("cpu_s", "wall_s", "fit_s", "step_s", "memory_mb")
"""how the names of what is measured anew each time end"""
_DIGITS = 1e-6
"""relative difference of numbers that are the same: processors round differently"""
_ABOUT = ("machine", "made", "versions")
"""what a result says of its making"""


@dataclass(frozen=True)
class Arguments:
    """Make samples of stale tables again."""

    runs: tuple[str, ...] = ()
    """folders of runs; by default all"""
    having: str = ""
    """part of the name of the results: of these tables only, such as `default`"""
    of: tuple[str, ...] = ()
    """digests of code whose results are made again; by default all that is not here"""
    sample: int = 2
    """results of each code that made some of a table"""
    beside: bool = False
    """where a result differs from the stored one, make it by the code before too"""
    workers: int = 2
    """commands at a time"""


@dataclass(frozen=True)
class Sample:
    """Results of a table that the same code made, and where they differ when made again."""

    table: Table
    of: str | None
    """digest of the code that made them; None: not recorded"""
    paths: tuple[Path, ...]
    """those to make again"""
    differences: tuple[str, ...] = ()
    """the first of each result"""
    beside: tuple[str, ...] = ()
    """commits whose code was run here too"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    if arguments.sample < 1:
        raise SystemExit(f"--sample must be 1 or more, got {arguments.sample}.")
    asked = [t for t in named(TABLES, arguments.runs) if arguments.having in t.results]
    samples = [
        sample
        for table in asked
        for sample in samples_of(table, arguments.sample)
        if not arguments.of or sample.of in arguments.of
    ]
    if unknown := set(arguments.of) - {sample.of for sample in samples}:
        raise SystemExit(
            f"--of must name code whose results are to be made, got {sorted(unknown)}."
        )
    differing = 0
    with (
        TemporaryDirectory() as scratch,
        ThreadPoolExecutor(arguments.workers) as pool,
        closing(Maker(Path(scratch), pool)) as maker,
    ):
        for sample in samples:  # all begin before the first is waited for
            maker.start(sample)
        for sample in samples:
            compared = maker.compare(sample)
            if compared.differences and arguments.beside:
                compared = maker.compare_beside(compared)
            print(line(compared), flush=True)
            if not compared.differences:
                confirm(compared)
            differing += bool(compared.differences)
    return int(differing > 0)


def samples_of(table: Table, count: int) -> Iterator[Sample]:
    """The results of a table to make again: some of each code that is neither here nor confirmed.

    Args:
        table: of the runs.
        count: how many of each code, evenly among those that are there.
    """
    if not table.again:
        return
    confirmed = confirmed_by(table)
    by_code: dict[str | None, list[Path]] = {}
    for path in table.paths():
        made = read_made(path)
        if state_of(made, table.code, confirmed) in ("stale", "unknown"):
            by_code.setdefault(made.get("digest"), []).append(path)
    for of, paths in by_code.items():
        step = max(len(paths) // count, 1)
        yield Sample(table, of, tuple(paths[::step][:count]))


class Maker:
    """Makes results by the code that is here, and by that of commits; the same command once."""

    def __init__(self, scratch: Path, pool: Executor) -> None:
        """Makes nothing yet.

        Args:
            scratch: an empty folder.
            pool: what runs the commands.
        """
        self._scratch = scratch
        self._pool = pool
        self._made: dict[tuple[Path, str, str], Future[Path]] = {}
        self._roots: dict[str, Path] = {}

    def start(self, sample: Sample, path: Path | None = None, commit: str = "") -> None:
        """Have results of a sample made, or one of them, by a commit's code or by that here."""
        for one in sample.paths if path is None else (path,):
            self._future(sample.table, one, self._root(commit))

    def compare(self, sample: Sample) -> Sample:
        """The sample with its differences from what is stored."""
        told = (self._difference(sample, path, path) for path in sample.paths)
        return replace(sample, differences=tuple(filter(None, told)))

    def compare_beside(self, sample: Sample) -> Sample:
        """The sample with the differences between the code of the commits that stored it and ours.

        Of results that are equal to the stored ones nothing is made.
        """
        differing = [path for path in sample.paths if self._difference(sample, path, path)]
        commits = {path: self._commit_of(sample, path) for path in differing}
        for path, commit in commits.items():
            if commit:
                self.start(sample, path, commit)
        told = []
        for path, commit in commits.items():
            name = _within_run(sample.table, path)
            if not commit:
                told.append(f"{name}: no commit that is named has the code of {sample.of}")
                continue
            before = self._future(sample.table, path, self._root(commit)).result()
            told.append(self._difference(sample, path, before / name))
        beside = tuple(sorted(set(filter(None, commits.values()))))
        return replace(sample, differences=tuple(filter(None, told)), beside=beside)

    def _commit_of(self, sample: Sample, path: Path) -> str:
        """The commit whose code made a result; empty where none has its digest."""
        named = str(read_made(path).get("commit") or "").removesuffix("-dirty")
        stored = git("log", "-1", "--format=%h", "--", str(path))
        if sample.of is None:
            return stored
        for commit in filter(None, (named, stored)):
            if sample.of in digests(self._root(commit), sample.table.run):
                return commit
        return ""

    def close(self) -> None:
        """Remove the checkouts of the commits."""
        for root in self._roots.values():
            git("worktree", "remove", "--force", str(root))

    def _difference(self, sample: Sample, path: Path, before: Path) -> str:
        """Between what was made again of a stored result and what was made before."""
        name = _within_run(sample.table, path)
        out = self._future(sample.table, path, ROOT).result()
        now = out / name
        if not now.exists():
            return (
                f"{name}: not made by {' '.join(sample.table.command(path))}; {last(out / ERRORS)}"
            )
        if not before.exists():
            return f"{name}: not made by the code before"
        difference = first_difference(read(before), read(now))
        return f"{name}: {difference}" if difference else ""

    def _future(self, table: Table, path: Path, root: Path) -> Future[Path]:
        command = table.command(path)
        key = (root, table.run, " ".join(command))
        if key not in self._made:
            out = self._scratch / f"out-{len(self._made)}"
            self._made[key] = self._pool.submit(make, table.run, command, root, out)
        return self._made[key]

    def _root(self, commit: str) -> Path:
        if not commit:
            return ROOT
        if commit not in self._roots:
            self._roots[commit] = self._scratch / f"code-{commit}"
            git("worktree", "add", "--detach", str(self._roots[commit]), commit)
        return self._roots[commit]


def digests(root: Path, run: str) -> list[str]:
    """The digests of the code of a run's tables, in a checkout."""
    program = (
        "import evidence; "
        f"print(*(table.code.digest for table in evidence.TABLES if table.run == {run!r}))"
    )
    told = subprocess.run(
        [sys.executable, "-c", program],
        cwd=root,
        env={**os.environ, "PYTHONPATH": _paths(root)},
        capture_output=True,
        text=True,
        check=False,
    )
    return told.stdout.split()


def _paths(root: Path) -> str:
    return os.pathsep.join(map(str, (root, root / "runs")))


def make(run: str, command: Sequence[str], root: Path, out: Path) -> Path:
    """The folder of results that a run's command has made, by the code of a checkout.

    There are none in it where the command failed; what it said of that is in `ERRORS`.
    """
    out.mkdir()
    folder = root / "runs" / run
    if (page := folder / "README.md").exists():
        shutil.copy(page, out)
    with (out / ERRORS).open("w") as errors:
        subprocess.run(
            [sys.executable, folder / "run.py", *command, "--out", out],
            cwd=root,
            env={**os.environ, "PYTHONPATH": _paths(root)},
            stdout=subprocess.DEVNULL,
            stderr=errors,
            check=False,
        )
    return out


def _within_run(table: Table, path: Path) -> Path:
    return path.relative_to(RUNS / table.run)


def last(path: Path) -> str:
    """The last line of a text."""
    return (path.read_text(encoding="utf-8").splitlines() or ["it says nothing"])[-1]


def read(path: Path) -> Any:
    """A result: what a JSON file holds, or the lines of a CSV file."""
    text = path.read_text(encoding="utf-8")
    return json.loads(text) if path.suffix == ".json" else text.splitlines()


def first_difference(stored: Any, found: Any, where: str = "") -> str:
    """Where two results differ first, and how; empty where they are equal but for times.

    What only one of them tells does not count: peers that were left out, a measure that is new.
    """
    if isinstance(stored, Mapping) and isinstance(found, Mapping):
        names = [name for name in stored if name in found and not _is_time(name)]
        pairs = ((name, stored[name], found[name]) for name in names)
    elif isinstance(stored, list) and isinstance(found, list) and len(stored) == len(found):
        pairs = ((str(i), *both) for i, both in enumerate(zip(stored, found, strict=True)))
    else:
        numbers = isinstance(stored, float) and isinstance(found, float)
        same = stored == found or (numbers and _same(stored, found))
        return "" if same else f"{where or 'all'} was {_short(stored)}, is {_short(found)}"
    told = (first_difference(was, now, f"{where}.{name}".strip(".")) for name, was, now in pairs)
    return next(filter(None, told), "")


def _same(stored: float, found: float) -> bool:
    both_nan = math.isnan(stored) and math.isnan(found)
    return both_nan or math.isclose(stored, found, rel_tol=_DIGITS)


def _is_time(name: str) -> bool:
    return name in _ABOUT or name.endswith(_TIMES)


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def confirm(sample: Sample) -> None:
    """Note in the folder of the run that these results are those of today's code."""
    table, of = sample.table, sample.of
    told = read_samples(table.run)
    told.setdefault(table.results, {})[of or "not recorded"] = {
        "of": of,
        "by": table.code.digest,
        "commit": COMMIT,
        "results": [path.stem for path in sample.paths],
        "beside": list(sample.beside),
        "machine": machine(),
    }
    write_bytes(RUNS / table.run / SAMPLES, json.dumps(told, indent=1).encode())


def line(sample: Sample) -> str:
    """The line that says whether a sample is equal, or where it differs."""
    state = "differs  " if sample.differences else "confirmed"
    said = f"{state} {sample.table.title}: {len(sample.paths)} of {sample.of or 'unknown code'}"
    if sample.beside:
        said += f", beside {', '.join(sample.beside)}"
    return "; ".join([said, *sample.differences])


if __name__ == "__main__":
    sys.exit(main())
