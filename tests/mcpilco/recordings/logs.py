"""Logs of a motion that is known, as a robot's controller writes them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from mcpilco.recordings import Recording, read_recording

STATES = ("cart_position", "cart_velocity", "pole_angle", "pole_velocity")
INPUTS = ("force",)
PAIRS = ((0, 1), (2, 3))
NAMES = ("time", *STATES, *INPUTS)


def motion(time: np.ndarray) -> np.ndarray:
    """Two sines with their derivatives, and a slower one as the input."""
    a, b = 2 * np.pi * 0.7, 2 * np.pi * 1.1
    return np.column_stack(
        [
            0.3 * np.sin(a * time),
            0.3 * a * np.cos(a * time),
            1.5 * np.sin(b * time + 1),
            1.5 * b * np.cos(b * time + 1),
            5 * np.sin(2.0 * time),
        ]
    )


def log(time: np.ndarray) -> np.ndarray:
    """Rows of time, states and input."""
    return np.column_stack([time, motion(time)])


def uniform(rows: int = 200, dt: float = 0.02) -> np.ndarray:
    return log(dt * np.arange(rows))


def write(path: Path, rows: np.ndarray, names: tuple[str, ...] = NAMES) -> Path:
    """A CSV in which NaN is an empty cell."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([["" if v != v else repr(v) for v in row] for row in rows.tolist()])
    return path


def read(path: Path, **options) -> Recording:
    options = {"angles": (2,), "velocities": PAIRS} | options
    return read_recording(path, STATES, INPUTS, **options)
