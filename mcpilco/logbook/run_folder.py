"""The folder of a run: plain files, each written whole or not at all, none executed when read.

config.json           everything to run it again
task.json             names, units and structure of states and inputs
metrics.csv           a row a trial; a row is there when all other files of its trial are
policy_steps.jsonl    numbers of each model fit, policy step and trial, one JSON object a line
trials/NN/            arrays of trial NN (npz) and its numbers (result.json); 00: the exploration
rollouts/NN.rrd       the rollout of trial NN for the Rerun viewer
agent.npz             the agent after the last finished trial
summary.json          the outcome, once the run is finished

A trial is finished once agent.npz knows of it, which is written after all else but its row in
metrics.csv: a run that was killed goes on from there, and `rewind` makes the rest agree.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from platform import python_version
from typing import Any

import numpy as np

from mcpilco.data import TrialResult
from mcpilco.files import (
    damaged,
    leftovers,
    read_arrays,
    read_text,
    require_own,
    write_arrays,
    write_bytes,
)
from mcpilco.logbook.metrics import check_values, read_metrics, values_of, write_metrics
from mcpilco.typing import RunFolderError

FORMAT = 2
"""version of the layout, in config.json"""
READABLE = (1, 2)
"""versions that are read; a run of version 1 drew other random numbers, and cannot be resumed"""
PACKAGES = ("mcpilco", "torch", "numpy", "scipy", "gymnasium", "mujoco", "rerun-sdk", "numba")
"""packages whose versions a run records"""

_CONFIG: Mapping[str, type] = {
    "env": str,
    "algo": str,
    "env_kwargs": dict,
    "preset": str,
    "seed": int,
    "trials": int,
    "config": dict,
    "versions": dict,
}


@dataclass(frozen=True)
class RunFolder:
    """One run on disk; make it with `create` or `open`.

    A file that is missing or damaged, or cannot be written, raises RunFolderError.
    """

    path: Path
    """the folder"""
    config: Mapping[str, Any]
    """config.json: format, env, env_kwargs, preset, seed, trials, config, versions"""

    @classmethod
    def create(cls, path: str | Path, config: Mapping[str, Any]) -> RunFolder:
        """A new run folder with its config.json and an empty metrics.csv.

        The folder does not exist or is empty; format and versions are added to the config.

        Raises:
            RunFolderError: the folder cannot be written, or holds something already.
        """
        path = Path(path)
        complete = {"format": FORMAT, "versions": versions(), **config}
        _check_config(path, complete)
        with _writing(path):
            if (path / "config.json").exists():
                raise RunFolderError(
                    f"{path} already holds a run; name another folder with --out, or delete it."
                )
            path.mkdir(parents=True, exist_ok=True)
            if set(path.iterdir()) - set(leftovers(path)):
                raise RunFolderError(f"{path} is not empty; name a new folder with --out.")
        write_json(path / "config.json", complete)
        run = cls(path, complete)
        run.rewind(None)
        return run

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """The run in this folder.

        Raises:
            RunFolderError: there is none, or its config.json is damaged or of an unknown format.
        """
        path = Path(path)
        if not (path / "config.json").is_file():
            raise RunFolderError(
                f"{path} holds no run: there is no config.json in it; "
                "name the folder that `mcpilco train` printed."
            )
        config = read_json(path / "config.json")
        _check_config(path, config)
        return cls(path, config)

    @property
    def agent_path(self) -> Path:
        """The agent after the last finished trial."""
        return self.path / "agent.npz"

    @property
    def policy_steps_path(self) -> Path:
        """Numbers of each policy step, for `JsonLines`."""
        return self.path / "policy_steps.jsonl"

    def arrays_path(self, trial: int, name: str) -> Path:
        """The file of one kind of a trial's arrays, such as `rollout`; 0 is the exploration."""
        return self.path / "trials" / f"{trial:02d}" / f"{name}.npz"

    def write_arrays(self, trial: int, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Write a trial's arrays of one kind, such as `rollout`."""
        path = self.arrays_path(trial, name)
        with _writing(path.parent):
            path.parent.mkdir(exist_ok=True)
        write_arrays(path, arrays)

    def read_arrays(self, trial: int, name: str) -> dict[str, np.ndarray]:
        """A trial's arrays of one kind, such as `policy`; pickled objects are refused."""
        return read_arrays(self.arrays_path(trial, name))

    def recording_path(self, trial: int) -> Path:
        """The recording of a trial's rollout for the Rerun viewer."""
        return self.path / "rollouts" / f"{trial:02d}.rrd"

    def metrics(self) -> list[dict[str, Any]]:
        """The rows of metrics.csv, one for each finished trial."""
        return read_metrics(self.path / "metrics.csv")

    def write_result(self, result: TrialResult) -> None:
        """Write the numbers of a trial."""
        write_json(self._result_path(result.trial), values_of(result))

    def result(self, trial: int) -> dict[str, Any]:
        """The numbers of a trial: the entries of `mcpilco.data.TrialResult` but for its arrays."""
        path = self._result_path(trial)
        values = read_json(path)
        if values.get("trial") != trial:
            raise damaged(path, f"`trial` must be {trial}, got {values.get('trial')!r}")
        check_values(path, values)
        return values

    def _result_path(self, trial: int) -> Path:
        return self.arrays_path(trial, "result").with_suffix(".json")

    def add_metrics(self, result: TrialResult) -> None:
        """Append a trial to metrics.csv; write everything else of the trial before."""
        write_metrics(self.path / "metrics.csv", [*self.metrics(), values_of(result)])

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Keeps other processes from writing to the run, until its end or this process's.

        Raises:
            RunFolderError: another process does so already, or a file of the run lies elsewhere.
        """
        require_own(self.path)
        with _writing(self.path):
            descriptor = os.open(self.path, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            raise RunFolderError(
                f"Another process is writing to {self.path}; wait for its end, or stop it."
            ) from error
        try:
            yield
        finally:
            os.close(descriptor)

    def with_trials(self, trials: int) -> RunFolder:
        """The same run, of another number of trials."""
        config = {**self.config, "trials": trials}
        write_json(self.path / "config.json", config)
        return RunFolder(self.path, config)

    def rewind(self, trial: int | None) -> None:
        """Take away what came after the end of a trial, and complete metrics.csv up to it.

        The trial is the last that agent.npz knows of, 0 the exploration; None: there is no agent.

        Raises:
            RunFolderError: a finished trial would be lost, or the folder cannot be written.
        """
        last = trial or 0
        rows = [self.result(number) for number in range(1, last + 1)]
        table = self.path / "metrics.csv"
        if table.exists() and len(finished := self.metrics()) > last:
            raise RunFolderError(
                f"{self.path} holds {len(finished)} finished trials, but its agent.npz knows of "
                f"{last}; restore agent.npz from a copy."
            )
        with _writing(self.path):
            for leftover in leftovers(self.path):
                leftover.unlink()
            for folder in (self.path / "trials", self.path / "rollouts"):
                if folder.is_symlink():
                    raise damaged(folder, "it is a link, and a run has none")
                folder.mkdir(exist_ok=True)
                for path in folder.iterdir():
                    if _number(path) >= (0 if trial is None else last + 1):
                        shutil.rmtree(path) if path.is_dir() else path.unlink()
            (self.path / "summary.json").unlink(missing_ok=True)
        if self.policy_steps_path.exists():
            write_bytes(self.policy_steps_path, _lines_until(self.policy_steps_path, last))
        write_metrics(table, rows)

    def finished_trials(self) -> list[int]:
        """Numbers of the trials that are complete on disk: 1, 2, ..."""
        return [row["trial"] for row in self.metrics()]

    def write_summary(self, summary: Mapping[str, Any]) -> None:
        """Write summary.json; versions are added."""
        complete = {"format": FORMAT, **summary, "versions": versions()}
        write_json(self.path / "summary.json", complete)

    def summary(self) -> dict[str, Any] | None:
        """summary.json, or None while the run is not finished."""
        path = self.path / "summary.json"
        return read_json(path) if path.exists() else None


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that a run depends on, where they are installed."""
    found = {"python": python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON object, indented, whole or not at all."""
    write_bytes(path, (json.dumps(content, indent=2) + "\n").encode())


def read_json(path: Path) -> dict[str, Any]:
    """The JSON object in a file."""
    try:
        content = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise damaged(path, error) from error
    if not isinstance(content, dict):
        raise RunFolderError(
            f"{path} is damaged: expected a JSON object, got {type(content).__name__}."
        )
    return content


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise RunFolderError(
            f"{path} cannot be written ({error.strerror or error}); "
            "choose a folder that you may write to, with space left."
        ) from error


def _number(path: Path) -> int:
    """The trial that a file or folder of a run is named after; -1 for one that is not ours."""
    digits = path.stem.partition("-")[0]
    return int(digits) if re.fullmatch(r"\d{2,9}", digits, re.ASCII) else -1


def _lines_until(path: Path, trial: int) -> bytes:
    """The whole lines of policy_steps.jsonl up to the end of a trial."""
    kept = []
    for line in read_text(path).splitlines():
        try:
            if json.loads(line)["time/trial"] > trial:
                break
        except (ValueError, KeyError, TypeError, RecursionError):
            break  # the writer was stopped here
        kept.append(f"{line}\n")
    return "".join(kept).encode()


def _check_config(path: Path, config: Mapping[str, Any]) -> None:
    """Raises RunFolderError where the config is of another format, or lacks something."""
    found = config.get("format")
    if isinstance(found, int) and found > FORMAT:
        raise RunFolderError(
            f"{path} has format version {found}, this mcpilco reads {READABLE}; "
            "install a newer mcpilco."
        )
    known = found in READABLE and not isinstance(found, bool)
    _require(path, config, "format", known, f"one of {READABLE}")
    for key, kind in _CONFIG.items():
        value = config.get(key, "mcpilco" if key == "algo" else None)  # the first runs had no other
        fits = isinstance(value, kind) and not isinstance(value, bool)
        _require(path, config, key, fits, f"of type {kind.__name__}")
    for key, least in (("seed", 0), ("trials", 1)):
        _require(path, config, key, config[key] >= least, f"at least {least}")


def _require(path: Path, config: Mapping[str, Any], key: str, fits: bool, expected: str) -> None:
    if not fits:
        raise RunFolderError(
            f"{path / 'config.json'} is damaged: `{key}` must be {expected}, "
            f"got {config.get(key)!r}."
        )
