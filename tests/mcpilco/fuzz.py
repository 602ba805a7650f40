"""Damage to run folders and saved agents, by chance and by intent, and what it must not do."""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import shutil
import signal
import traceback
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mcpilco.agent import MCPILCO
from mcpilco.cli import main
from mcpilco.logbook import RunFolder
from mcpilco.typing import McPilcoError
from tests.mcpilco.survival import resume

LIMIT_S = 30
"""for each thing that is tried with a damaged folder"""
MEMORY = 2**29
"""more memory than before that damaged folders may take [bytes]; half of what is ever unpacked"""
ADDRESSES = 2**34
"""more address space, of which Rerun's threads take much [bytes]"""

Random = np.random.Generator
HOSTILE = [
    *(None, True, False, -1, 0, 1, 2, 10**30, -(10**30), 1e308, 1e-308, float("nan")),
    *(float("inf"), "", "a", "1", "../../x", "x" * 20_000, [], {}, [[]], [1, "a"], {"a": {}}),
]
"""values that may take the place of any other in a JSON file"""


class Bomb:
    """Makes a folder where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return (os.mkdir, (str(self.mark),))


# --- damage, of a file


def flip_bits(file: Path, rng: Random, mark: Path) -> None:
    content = bytearray(file.read_bytes())
    for place in rng.integers(0, max(len(content), 1), rng.integers(1, 20)):
        content[place : place + 1] = bytes([rng.integers(256)])
    file.write_bytes(content)


def truncate(file: Path, rng: Random, mark: Path) -> None:
    content = file.read_bytes()
    file.write_bytes(content[: rng.integers(0, len(content) + 1)])


def fill(file: Path, rng: Random, mark: Path) -> None:
    """A stretch of zeros, as a file system may leave; or more bytes at the end."""
    content = bytearray(file.read_bytes())
    begin = int(rng.integers(0, len(content) + 1))
    content[begin : begin + int(rng.integers(1, 500))] = bytes(int(rng.integers(1, 500)))
    file.write_bytes(content)


def replace_by_pickle(file: Path, rng: Random, mark: Path) -> None:
    import pickle

    file.write_bytes(pickle.dumps(Bomb(mark)))


def replace_by_something_else(file: Path, rng: Random, mark: Path) -> None:
    file.unlink()
    match rng.integers(5):
        case 0:
            file.mkdir()
        case 1:
            file.symlink_to("/dev/zero")
        case 2:
            file.symlink_to(file.name)
        case 3:
            os.mkfifo(file)


def swap(file: Path, rng: Random, mark: Path) -> None:
    """With another file of the run, of the same kind or not."""
    files = [other for other in _files(_run_of(file)) if other != file]
    other = files[rng.integers(len(files))]
    content = file.read_bytes()
    file.write_bytes(other.read_bytes())
    other.write_bytes(content)


# --- damage, of what a file says


def edit_json(file: Path, rng: Random, mark: Path) -> None:
    if file.suffix == ".npz":
        edit_about(file, rng, mark)
    elif file.suffix in (".json", ".jsonl"):
        first, *rest = file.read_text().split("\n", 1) if file.suffix == ".jsonl" else [""]
        text = first if rest else file.read_text()
        file.write_text(_edited(text, rng) + "".join(f"\n{more}" for more in rest))
    else:
        edit_line(file, rng, mark)


def edit_about(file: Path, rng: Random, mark: Path) -> None:
    members = _members(file)
    if "about.npy" in members:
        about = str(np.load(io.BytesIO(members["about.npy"])))
        members["about.npy"] = _npy(np.array(_edited(about, rng)))
        _write_zip(file, list(members.items()))
    else:
        edit_array(file, rng, mark)


def _edited(text: str, rng: Random) -> str:
    """A JSON object with one place changed; or nested too deep, or with a number too long."""
    if rng.random() < 0.1:
        return str(rng.choice(["[" * 50_000, '{"a":' * 50_000, '{"seed": 1' + "0" * 9000 + "}"]))
    place = root = json.loads(text)
    parent, name = None, None
    while isinstance(place, dict | list) and place and (parent is None or rng.random() < 0.8):
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        parent, name = place, keys[rng.integers(len(keys))]
        place = place[name]
    if parent is None:
        return json.dumps(HOSTILE[rng.integers(len(HOSTILE))])
    if rng.random() < 0.25:
        del parent[name]
    else:
        parent[name] = HOSTILE[rng.integers(len(HOSTILE))]
    if isinstance(parent, dict) and rng.random() < 0.1:
        parent["more"] = 1
    return json.dumps(root)


def edit_line(file: Path, rng: Random, mark: Path) -> None:
    """A cell of a table, or a line of anything."""
    lines = file.read_bytes().split(b"\n")
    number = int(rng.integers(len(lines)))
    cells = lines[number].split(b",")
    strange = [
        b"",
        b"nan",
        b"inf",
        b"-1",
        b"1e999",
        b"1" * 9000,
        b'"',
        b"\0",
        b"\xff",
        b"x" * 200_000,
    ]
    cells[rng.integers(len(cells))] = strange[rng.integers(len(strange))]
    lines[number] = b",".join(cells)
    if rng.random() < 0.2:
        lines *= 2
    file.write_bytes(b"\n".join(lines))


def edit_array(file: Path, rng: Random, mark: Path) -> None:
    """One array of the file is another one, or none at all."""
    if file.suffix != ".npz":
        return edit_line(file, rng, mark)
    members = _members(file)
    name = list(members)[rng.integers(len(members))]
    array = np.load(io.BytesIO(members[name]))
    others: list[Callable[[], bytes]] = [
        lambda: _npy(np.full(array.shape, np.nan)),
        lambda: _npy(np.full(array.shape, 1e308)),
        lambda: _npy(np.zeros(array.shape)),
        lambda: _npy(np.zeros((*array.shape, 2))),
        lambda: _npy(array[:0] if array.ndim else np.zeros(0)),
        lambda: _npy(np.array(3.0)),
        lambda: _npy(np.full(array.shape, "a")),
        lambda: _npy(np.zeros(array.shape, complex)),
        lambda: _npy(np.zeros(array.shape, [("a", float)])),
        lambda: _npy(np.zeros(array.shape, np.int8)),
        lambda: _npy(np.array([Bomb(mark)], dtype=object)),
        lambda: _head((10**12,)),
        lambda: _head((2**31, 2**31, 2**31)),
        lambda: _head((-1,)),
        lambda: b"",
        lambda: rng.bytes(300),
    ]
    members[name] = others[rng.integers(len(others))]()
    _write_zip(file, list(members.items()))


def edit_zip(file: Path, rng: Random, mark: Path) -> None:
    """Members that should not be there, or that are missing."""
    if file.suffix != ".npz":
        return edit_line(file, rng, mark)
    members = list(_members(file).items())
    name, content = members[rng.integers(len(members))]
    match rng.integers(6):
        case 0:
            members.remove((name, content))
        case 1:
            members.append((name, content))  # twice
        case 2:
            members.append((f"../../../{mark.name}.npy", content))
        case 3:
            members.append((f"{mark}.npy", content))  # absolute
        case 4:
            with zipfile.ZipFile(file, "a", zipfile.ZIP_DEFLATED) as archive:
                _add_bomb(archive)
            return
        case 5:
            members.append(("code.py", b"raise SystemExit(9)"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a name twice
        _write_zip(file, members)


DAMAGES = (
    flip_bits,
    truncate,
    fill,
    replace_by_pickle,
    replace_by_something_else,
    swap,
    edit_json,
    edit_json,
    edit_array,
    edit_array,
    edit_zip,
    edit_line,
)


def _npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def _head(shape: tuple[int, ...]) -> bytes:
    """An array that claims a shape, of which a few bytes follow."""
    buffer = io.BytesIO()
    head = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(buffer, head)
    return buffer.getvalue() + bytes(64)


def _add_bomb(archive: zipfile.ZipFile) -> None:
    """An array that takes half a gigabyte, and packed half a megabyte."""
    with archive.open("bomb.npy", "w", force_zip64=True) as member:
        head = {"descr": "<f8", "fortran_order": False, "shape": (2**26,)}
        np.lib.format.write_array_header_1_0(member, head)
        for _ in range(2**9):
            member.write(bytes(2**20))


def _members(file: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(file) as archive:
        if sum(member.file_size for member in archive.infolist()) > 2**26:
            raise ValueError("it has its bomb already")
        return {name: archive.read(name) for name in archive.namelist()}


def _write_zip(file: Path, members: list[tuple[str, bytes]]) -> None:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            archive.writestr(name, content)


def _files(run: Path) -> list[Path]:
    return sorted(path for path in run.rglob("*") if path.is_file() and not path.is_symlink())


def _run_of(file: Path) -> Path:
    return next(folder for folder in file.parents if folder.name == "run")


def damage(run: Path, rng: Random, mark: Path) -> list[str]:
    """Does something to one to three files of a run; returns what."""
    done = []
    for _ in range(rng.integers(1, 4)):
        files = _files(run)
        # what is read most is damaged most
        central = [f for f in files if f.parent == run or f.name in ("policy.npz", "result.json")]
        chosen = central if rng.random() < 0.7 else files
        file, how = chosen[rng.integers(len(chosen))], DAMAGES[rng.integers(len(DAMAGES))]
        with contextlib.suppress(Exception):  # it may be too damaged already
            how(file, rng, mark)
            done.append(f"{how.__name__} {file.relative_to(run)}")
    return done


# --- what is tried


def _library(run: Path) -> None:
    folder = RunFolder.open(run)
    folder.summary()
    for trial in folder.finished_trials():
        folder.result(trial)
        for name in ("rollout", "transitions", "particles", "policy", "gp"):
            folder.read_arrays(trial, name)


def _agent(run: Path) -> None:
    agent = MCPILCO.load(run / "agent.npz")
    answer, _ = agent.predict(np.zeros((3, len(agent.task.state_names))))
    assert np.isfinite(answer).all()


def _attempts(run: Path, seed: int) -> dict[str, Callable[[], int | None]]:
    """What is tried; going on takes long, and is for some only."""
    attempts: dict[str, Callable[[], int | None]] = {
        "open": lambda: _library(run),
        "load": lambda: _agent(run),
        "export": lambda: main(["export", str(run), str(run.parent / "policy.npz")]),
        "evaluate": lambda: main(["evaluate", str(run), "--episodes", "1"]),
        "resume": lambda: main([*resume(run), "--trials", "4"]),
    }
    return attempts if seed % 5 == 0 else {k: v for k, v in attempts.items() if k != "resume"}


class HangError(BaseException):
    """Something took longer than `LIMIT_S`; no `except Exception` may hide it."""


def _alarm(*_: Any) -> None:
    raise HangError


def try_all(source: str, work: str, seeds: list[int], report: str) -> None:
    """Damages a copy of a run for each seed and tries everything with it, in this process.

    A line of JSON a seed goes to `report`: what was done, and the outcome of each attempt: `read`,
    `refused`, or the traceback of what must not be.
    """
    signal.signal(signal.SIGALRM, _alarm)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + ADDRESSES, hard))
    before = _largest()
    for seed in seeds:
        run, mark = Path(work) / "run", Path(work) / "executed"
        shutil.copytree(source, run)
        done = damage(run, np.random.default_rng(seed), mark)
        outcomes = {name: _outcome(attempt) for name, attempt in _attempts(run, seed).items()}
        if mark.exists() or Path(f"{mark}.npy").exists():
            outcomes["executed"] = "something in the folder was executed, or unpacked"
        if _largest() - before > MEMORY:
            outcomes["memory"] = f"{_largest() - before} bytes more than before"
        line = {"seed": seed, "done": done, "outcomes": outcomes, "grown": _largest() - before}
        with open(report, "a") as file:
            file.write(json.dumps(line) + "\n")
        shutil.rmtree(work)
        Path(work).mkdir()


def _largest() -> int:
    """The most memory that this process ever had [bytes]."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _outcome(attempt: Callable[[], int | None]) -> str:
    """`read`, `refused`, or a traceback."""
    signal.alarm(LIMIT_S)
    try:
        with (
            open(os.devnull, "w") as nowhere,
            contextlib.redirect_stdout(nowhere),
            contextlib.redirect_stderr(nowhere),
        ):
            code = attempt()
        return {None: "read", 0: "read", 2: "refused"}.get(code, f"exit code {code}")
    except McPilcoError:
        return "refused"
    except BaseException:
        return traceback.format_exc()
    finally:
        signal.alarm(0)
