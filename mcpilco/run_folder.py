"""The folder of a run: plain files, each written whole or not at all, none executed when read.

config.json           everything to run it again
task.json             names, units and structure of states and inputs
metrics.csv           a row a trial; a row is there when all other files of its trial are
policy_steps.jsonl    numbers of each model fit, policy step and trial, one JSON object a line
trials/NN/            arrays of trial NN (npz); 00 is the exploration
rollouts/NN.rrd       the rollout of trial NN for the Rerun viewer
agent.npz             the agent after the last finished trial
summary.json          the outcome, once the run is finished
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from platform import python_version
from typing import Any

import numpy as np

from mcpilco.archive import read_arrays, write_arrays, write_bytes
from mcpilco.data import TrialResult
from mcpilco.typing import RunFolderError

FORMAT = 1
"""version of the layout, in config.json"""
PACKAGES = ("mcpilco", "torch", "numpy", "scipy", "gymnasium", "mujoco", "rerun-sdk", "numba")
"""packages whose versions a run records"""

_CONFIG: Mapping[str, type] = {
    "env": str,
    "env_kwargs": dict,
    "preset": str,
    "seed": int,
    "trials": int,
    "config": dict,
    "versions": dict,
}


def _optional(read: Callable[[str], Any]) -> Callable[[str], Any]:
    return lambda text: None if text == "" else read(text)


def _flag(text: str) -> bool:
    return {"0": False, "1": True}[text]


METRICS: Mapping[str, Callable[[str], Any]] = {
    "trial": int,
    "experience_s": float,
    "predicted_cost": float,
    "real_cost": float,
    "success": _optional(_flag),
    "time_up_s": _optional(float),
    "mean_abs_cart_m": _optional(float),
    "wall_s": float,
    "cpu_s": float,
}
"""columns of metrics.csv and how each is read; empty: the env does not tell; success: 1 or 0"""


@dataclass(frozen=True)
class RunFolder:
    """One run on disk; make it with `create` or `open`."""

    path: Path
    """the folder"""
    config: Mapping[str, Any]
    """config.json: format, env, env_kwargs, preset, seed, trials, config, versions"""

    @classmethod
    def create(cls, path: str | Path, config: Mapping[str, Any]) -> RunFolder:
        """A new run folder with its config.json and an empty metrics.csv.

        Args:
            path: a folder that does not exist or is empty.
            config: env, env_kwargs, preset, seed, trials and config; format and versions are added.

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
            if any(path.iterdir()):
                raise RunFolderError(f"{path} is not empty; name a new folder with --out.")
        for folder in ("trials", "rollouts"):
            with _writing(path):
                (path / folder).mkdir()
        run = cls(path, complete)
        run._write_metrics([])
        write_json(path / "config.json", complete)
        return run

    @classmethod
    def open(cls, path: str | Path) -> RunFolder:
        """The run in this folder.

        Raises:
            RunFolderError: there is none, or its config.json is damaged or of a later format.
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
        """Write a trial's arrays of one kind, such as `rollout`.

        Raises:
            RunFolderError: the file cannot be written.
        """
        path = self.arrays_path(trial, name)
        with _writing(path.parent):
            path.parent.mkdir(exist_ok=True)
        write_arrays(path, arrays)

    def read_arrays(self, trial: int, name: str) -> dict[str, np.ndarray]:
        """A trial's arrays of one kind, such as `policy`; pickled objects are refused.

        Raises:
            RunFolderError: the file is missing, damaged, or holds more than plain arrays.
        """
        return read_arrays(self.arrays_path(trial, name))

    def recording_path(self, trial: int) -> Path:
        """The recording of a trial's rollout for the Rerun viewer."""
        return self.path / "rollouts" / f"{trial:02d}.rrd"

    def metrics(self) -> list[dict[str, Any]]:
        """The rows of metrics.csv, one for each finished trial.

        Raises:
            RunFolderError: the file is missing or damaged.
        """
        path = self.path / "metrics.csv"
        with _reading(path):
            header, *rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines())) or [[]]
        if header != list(METRICS):
            expected, found = ",".join(METRICS), ",".join(header)
            raise RunFolderError(f"{path} is damaged: line 1 must be {expected}, got {found!r}.")
        return [_metrics_row(path, number, row) for number, row in enumerate(rows, start=2)]

    def add_metrics(self, result: TrialResult) -> None:
        """Append a trial to metrics.csv; write everything else of the trial before.

        Raises:
            RunFolderError: the file is damaged or cannot be written.
        """
        row = {column: getattr(result, column) for column in METRICS}
        self._write_metrics([*self.metrics(), row])

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

    def _write_metrics(self, rows: list[dict[str, Any]]) -> None:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(METRICS)
        writer.writerows([_cell(row[column]) for column in METRICS] for row in rows)
        write_bytes(self.path / "metrics.csv", text.getvalue().encode())


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
    """The JSON object in a file.

    Raises:
        RunFolderError: the file is missing, or is not one JSON object.
    """
    with _reading(path):
        content = json.loads(path.read_text(encoding="utf-8"))
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


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError as error:
        raise RunFolderError(f"{path} is missing; the run is not complete.") from error
    except OSError as error:
        raise RunFolderError(f"{path} cannot be read ({error.strerror or error}).") from error
    except (ValueError, RecursionError, csv.Error) as error:
        raise RunFolderError(
            f"{path} is damaged ({error}); restore it from a copy, or train again."
        ) from error


def _check_config(path: Path, config: Mapping[str, Any]) -> None:
    """Raises RunFolderError where the config is of another format, or lacks something."""
    found = config.get("format")
    if isinstance(found, int) and found > FORMAT:
        raise RunFolderError(
            f"{path} has format version {found}, this mcpilco reads {FORMAT}; "
            "install a newer mcpilco."
        )
    if found != FORMAT:
        raise RunFolderError(
            f"{path / 'config.json'} is damaged: `format` must be {FORMAT}, got {found!r}."
        )
    for key, kind in _CONFIG.items():
        value = config.get(key)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise RunFolderError(
                f"{path / 'config.json'} is damaged: "
                f"`{key}` must be of type {kind.__name__}, got {value!r}."
            )


def _metrics_row(path: Path, number: int, row: list[str]) -> dict[str, Any]:
    try:
        pairs = zip(METRICS.items(), row, strict=True)
        return {column: read(text) for (column, read), text in pairs}
    except (ValueError, KeyError) as error:
        raise RunFolderError(
            f"{path} is damaged: line {number} must hold the {len(METRICS)} values "
            f"{','.join(METRICS)}, got {','.join(row)!r}."
        ) from error


def _cell(value: float | bool | None) -> str:
    """As text that reads back equal."""
    if value is None:
        return ""
    if isinstance(value, bool | int | np.bool_ | np.integer):
        return str(int(value))
    return repr(float(value))
