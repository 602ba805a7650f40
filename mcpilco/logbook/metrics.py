"""The numbers of a trial: as JSON values, and as a row of metrics.csv."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from mcpilco.data import TrialResult
from mcpilco.files import damaged, read_text, write_bytes
from mcpilco.typing import RunFolderError


def _optional(read: Callable[[str], Any]) -> Callable[[str], Any]:
    return lambda text: None if text == "" else read(text)


def _flag(text: str) -> bool:
    return {"0": False, "1": True}[text]


METRICS: Mapping[str, Callable[[str], Any]] = {
    "trial": int,
    "experience_s": float,
    "predicted_cost": _optional(float),
    "real_cost": _optional(float),
    "success": _optional(_flag),
    "time_up_s": _optional(float),
    "mean_abs_cart_m": _optional(float),
    "wall_s": float,
    "cpu_s": float,
    "failure": _optional(str),
}
"""columns of metrics.csv and how each is read; empty: not told, or not finite; success: 1 or 0"""
ABSENT_IN_FORMAT_1 = ("failure",)
"""columns that the first run folders did not have"""


def values_of(result: TrialResult) -> dict[str, Any]:
    """A trial's result but for its arrays, as JSON values; None for what is not finite."""
    names = [field.name for field in fields(result) if field.name not in ("rollout", "prediction")]
    return {name: _json(getattr(result, name)) for name in names}


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """The rows of metrics.csv: of trials 1, 2, ...

    Raises:
        RunFolderError: the file is missing or damaged.
    """
    try:
        header, *rows = list(csv.reader(read_text(path).splitlines())) or [[]]
    except csv.Error as error:
        raise damaged(path, error) from error
    older = [name for name in METRICS if name not in ABSENT_IN_FORMAT_1]
    if header not in (list(METRICS), older):
        expected, found = ",".join(METRICS), ",".join(header)
        raise RunFolderError(f"{path} is damaged: line 1 must be {expected}, got {found!r}.")
    return [_row(path, header, trial, row) for trial, row in enumerate(rows, start=1)]


def write_metrics(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write metrics.csv: the columns of `METRICS`, of rows that may hold more.

    Raises:
        RunFolderError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(METRICS)
    writer.writerows([_cell(row[column]) for column in METRICS] for row in rows)
    write_bytes(path, text.getvalue().encode())


def check_values(path: Path, values: Mapping[str, Any]) -> None:
    """Make sure that these are values of a trial, which can take their row in metrics.csv.

    Args:
        path: where they were read, for the message.
        values: what `values_of` says of a trial, or a file that claims so.

    Raises:
        RunFolderError: an entry is missing, or of another type.
    """
    for column, read in METRICS.items():
        try:
            value = values[column]
            if read(_cell(value)) != value:
                raise ValueError
        except (KeyError, ValueError, TypeError) as error:
            found = repr(values.get(column))[:80]
            raise damaged(path, f"`{column}` must be as in metrics.csv, got {found}") from error
    steps = values.get("policy_steps")
    if not isinstance(steps, int) or steps < 0:
        raise damaged(path, f"`policy_steps` must be an integer of at least 0, got {steps!r:.80}")


def _row(path: Path, header: list[str], trial: int, cells: list[str]) -> dict[str, Any]:
    try:
        pairs = zip(header, cells, strict=True)
        row = {column: METRICS[column](text) for column, text in pairs}
        if row["trial"] != trial:
            raise ValueError
    except (ValueError, KeyError) as error:
        raise RunFolderError(
            f"{path} is damaged: line {trial + 1} must hold the {len(header)} values "
            f"{','.join(header)} of trial {trial}, got {','.join(cells)!r}."
        ) from error
    return {column: row.get(column) for column in METRICS}


def _cell(value: float | bool | str | None) -> str:
    """As text that reads back equal."""
    if value is None or isinstance(value, str):
        return value or ""
    return str(int(value)) if isinstance(value, bool | int) else repr(value)


def _json(value: Any) -> Any:
    """As JSON has it; None for a number that is not finite."""
    if isinstance(value, tuple | list):
        return [_json(entry) for entry in value]
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    return float(value) if math.isfinite(value) else None
