"""Inputs and outputs at one sampling time, as a Volterra series sees them, and what is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mcpilco.recordings.reader import LogRows, read_rows
from mcpilco.recordings.recording import Samples
from mcpilco.typing import InputError, RecordingError

_FEWEST = 20
"""fewest samples that a series is learned from"""
_UNEVEN = 0.2
"""a step of time that differs from the median by more than this part of it is another step [-]"""
_REPEATED, _TOO_OFTEN = 0.01, 0.2
"""shares of rows that repeat the row before: from which there is a warning, and a refusal [-]"""
_DEPENDENT = 1e-10
"""a direction of the lags with less than this part of the largest one's power is not excited [-]"""
_OFF_ZERO = 2.0
"""a mean of an input beyond so many of its standard deviations is worth a word"""


@dataclass(frozen=True)
class Series(Samples):
    """Inputs and outputs measured at times k = 0, 1, ..., T - 1, one sampling time apart."""

    inputs: Float[np.ndarray, "T U"]
    """each in its own unit; NaN where it is missing"""
    outputs: Float[np.ndarray, "T E"]
    """likewise"""
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    remarks: tuple[str, ...] = ()
    """sentences on rows of the file that were left out"""

    @classmethod
    def of(cls, inputs: np.ndarray, outputs: np.ndarray) -> Series:
        """Arrays (T,) or (T, U) and (T,) or (T, E), with names `u`, or `u0`, `u1`, ... of columns.

        Raises:
            InputError: the arrays do not belong together.
        """
        u, y = (np.asarray(a, dtype=float) for a in (inputs, outputs))
        u, y = (a[:, None] if a.ndim == 1 else a for a in (u, y))
        if u.ndim != 2 or y.ndim != 2 or len(u) != len(y) or 0 in (u.shape[1], y.shape[1]):
            raise InputError(
                "A series needs inputs (T, U) and outputs (T, E) at the same times, got shapes "
                f"{np.shape(inputs)} and {np.shape(outputs)}."
            )
        return cls(u, y, _names("u", u.shape[1]), _names("y", y.shape[1]))


def _names(letter: str, count: int) -> tuple[str, ...]:
    return (letter,) if count == 1 else tuple(f"{letter}{i}" for i in range(count))


def lagged(inputs: Float[np.ndarray, "T U"], lags: int) -> Float[np.ndarray, "N D"]:
    """Regressors of times lags, ..., T - 1: u_k, u_{k-1}, ..., u_{k-lags} of each input in turn."""
    windows = np.lib.stride_tricks.sliding_window_view(inputs, lags + 1, axis=0)
    return windows[..., ::-1].reshape(len(windows), -1)


def read_series(path: str | Path, inputs: Sequence[str], outputs: Sequence[str]) -> Series:
    """The named columns of a CSV, npz, mat or parquet file, a row a sample.

    Where there is a column `time` its steps must be even.

    Raises:
        RecordingError: the file cannot be read, lacks a column, or its steps are uneven.
    """
    rows = read_rows(path, (*inputs, *outputs), optional=["time"])
    _require_even(rows)
    u, y = rows.columns(inputs), rows.columns(outputs)
    return Series(u, y, tuple(inputs), tuple(outputs), rows.remarks)


def _require_even(rows: LogRows) -> None:
    steps = np.diff(rows.time)
    dt = float(np.median(steps)) if len(steps) else 0.0
    wrong = np.flatnonzero(np.abs(steps - dt) > _UNEVEN * dt)
    if len(wrong):
        raise RecordingError(
            f"{rows.table.path}, row {rows.row(wrong[0] + 1)}: expected a step of {dt:g} s as in "
            f"most rows, got {steps[wrong[0]]:g} s ({len(wrong)} such steps in all); a Volterra "
            "series counts samples: record at an even rate, or resample, with empty cells where "
            "values are lost."
        )


def usable(series: Series, lags: int) -> tuple[Float[np.ndarray, "N D"], Float[np.ndarray, "N E"]]:
    """The regressors and outputs of all times whose lags and outputs are all known.

    Raises:
        InputError: there are too few of them, or nothing can be learned of them.
    """
    width = series.inputs.shape[1] * (lags + 1)
    if len(series) <= lags:
        raise _too_few(series, lags, 0, width)
    X, Y = lagged(series.inputs, lags), series.outputs[lags:]
    known = np.isfinite(X).all(1) & np.isfinite(Y).all(1)
    X, Y = X[known], Y[known]
    if len(X) < max(width + 1, _FEWEST):
        raise _too_few(series, lags, len(X), width)
    _require_variation(series.input_names, series.inputs, "input")
    _require_variation(series.output_names, series.outputs, "output")
    if _repeated(series) > _TOO_OFTEN:
        raise InputError(
            f"{_repeated(series):.0%} of the rows repeat the row before: the log is faster than "
            "its sensors, or rows were written twice; record one row a sample of the sensors."
        )
    return X, Y


def _too_few(series: Series, lags: int, found: int, width: int) -> InputError:
    return InputError(
        f"Of {len(series)} rows {found} have an output and all {lags} lags of each input, and "
        f"{max(width + 1, _FEWEST)} are needed: more than the {width} linear coefficients. Record "
        "for longer without gaps, or take fewer lags."
    )


def _require_variation(names: Sequence[str], columns: np.ndarray, kind: str) -> None:
    for name, column in zip(names, columns.T, strict=True):
        known = column[np.isfinite(column)]
        if np.ptp(known) <= 1e-12 * np.abs(known).max():
            remedy = (
                "record it while it takes many values at random"
                if kind == "input"
                else "check its sensor, or leave it out"
            )
            raise InputError(f"The {kind} {name!r} stands still at {known[0]:g}; {remedy}.")


def _repeated(series: Series) -> float:
    """The share of rows that are equal to the row before."""
    rows = np.concatenate([series.inputs, series.outputs], 1)
    return float((rows[1:] == rows[:-1]).all(1).mean())


def suspicions(
    series: Series, lags: int, degree: int, center: bool
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Coefficients that these data cannot determine, and warnings that say what to record."""
    unidentified, warnings = [], []
    for name, column in zip(series.input_names, series.inputs.T, strict=True):
        known = column[np.isfinite(column)]
        levels = len(np.unique(known))
        if levels <= degree:
            unidentified.append(f"powers of {name} from {levels} on")
            warnings.append(
                f"{name} takes {levels} values: its powers from {levels} on cannot be "
                f"distinguished from lower ones; record it with more than {degree} levels."
            )
        windows = lagged(column[:, None], lags)
        known_windows = windows[np.isfinite(windows).all(1)]
        powers = np.linalg.eigvalsh(known_windows.T @ known_windows)
        rank = int((powers > _DEPENDENT * powers[-1]).sum())
        if rank <= lags:
            unidentified.append(f"lags of {name}")
            warnings.append(
                f"The {lags + 1} lags of {name} move in {rank} directions only; record an input "
                "with more frequencies, best white noise."
            )
        if not center and abs(known.mean()) > _OFF_ZERO * known.std():
            warnings.append(
                f"{name} stands off zero (mean {known.mean():g}, standard deviation "
                f"{known.std():g}), and the series is developed about zero; centre the inputs."
            )
    if (share := _repeated(series)) > _REPEATED:
        warnings.append(f"{share:.0%} of the rows repeat the row before; are they measured?")
    return tuple(unidentified), tuple(warnings)
