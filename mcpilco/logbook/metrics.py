"""The numbers of a trial: as JSON values, and as a row of metrics.csv."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from mcpilco.data import TrialResult, is_measure
from mcpilco.files import csv_bytes, damaged, read_text, write_bytes
from mcpilco.typing import RunFolderError


def _optional(read: Callable[[str], Any]) -> Callable[[str], Any]:
    return lambda text: None if text == "" else read(text)


METRICS: Mapping[str, Callable[[str], Any]] = {
    "trial": int,
    "experience_s": float,
    "predicted_cost": _optional(float),
    "real_cost": _optional(float),
    "success": _optional({"0": False, "1": True}.__getitem__),
    "wall_s": float,
    "cpu_s": float,
    "failure": _optional(str),
    "limits_kept": _optional(float),
    "limits_crossed": _optional({"0": False, "1": True}.__getitem__),
}
"""columns of metrics.csv and how each is read; empty: not known, or not finite; success: 1 or 0.
Behind `success` come the measures that the env reports, numbers named with their unit"""
_measure = _optional(float)
NEWEST = ("limits_kept", "limits_crossed")
"""columns, and entries of a result, that older run folders do not have"""
ADDED = ("failure", *NEWEST)
"""columns that the first run folders did not have"""


def values_of(result: TrialResult) -> dict[str, Any]:
    """A trial's result but for its arrays, as JSON values; None for what is not finite."""
    names = [field.name for field in fields(result) if field.name not in ("rollout", "prediction")]
    values = {name: _json(getattr(result, name)) for name in names}
    return values | {name: _json(value) for name, value in result.outcome.items()}


def measures_in(row: Iterable[str]) -> list[str]:
    """The env's measures among the names in a trial's row or values."""
    return [name for name in row if is_measure(name)]


def read_metrics(path: Path) -> list[dict[str, Any]]:
    """The rows of metrics.csv: of trials 1, 2, ..."""
    try:
        header, *rows = list(csv.reader(read_text(path).splitlines())) or [[]]
    except csv.Error as error:
        raise damaged(path, error) from error
    expected = _columns(measures_in(header))
    known = [name for name in expected if name in header or name not in ADDED]
    if header != known:
        raise RunFolderError(
            f"{path} is damaged: line 1 must be {','.join(expected)}, got {','.join(header)!r}."
        )
    return [_row(path, header, trial, row) for trial, row in enumerate(rows, start=1)]


def write_metrics(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write metrics.csv: the columns of `METRICS` and the env's measures, of rows with more."""
    columns = _columns(measures_in(dict.fromkeys(name for row in rows for name in row)))
    cells = ([_cell(row.get(column)) for column in columns] for row in rows)
    write_bytes(path, csv_bytes(columns, cells))


def check_values(path: Path, values: Mapping[str, Any]) -> None:
    """Make sure that these are values of a trial, which can take their row in metrics.csv."""
    for column in _columns(measures_in(values)):
        read = METRICS.get(column, _measure)
        try:
            value = values.get(column) if column in NEWEST else values[column]
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
        row = {column: METRICS.get(column, _measure)(text) for column, text in pairs}
        if row["trial"] != trial:
            raise ValueError
    except (ValueError, KeyError) as error:
        raise RunFolderError(
            f"{path} is damaged: line {trial + 1} must hold the {len(header)} values "
            f"{','.join(header)} of trial {trial}, got {','.join(cells)!r}."
        ) from error
    return {column: row.get(column) for column in _columns(measures_in(header))}


def _columns(measures: Sequence[str]) -> list[str]:
    columns = list(METRICS)
    place = columns.index("success") + 1
    return [*columns[:place], *measures, *columns[place:]]


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
