"""Checks of the numbers that a user gives an environment; each answers with a sentence."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mcpilco.typing import InputError


def require_positive(name: str, value: Any, unit: str) -> None:
    """Raises InputError unless `value` is a finite number above 0."""
    if not (isinstance(value, int | float | np.number) and 0 < value < math.inf):
        raise InputError(f"{name} must be a positive number [{unit}], got {value!r}.")


def read_array(name: str, value: Any, *shapes: tuple[int, ...]) -> np.ndarray:
    """A finite float64 array of one of the shapes, a copy."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        array = None
    if array is None or array.shape not in shapes or not np.isfinite(array).all():
        expected = " or ".join(f"an array of shape {s}" if s else "one number" for s in shapes)
        raise InputError(f"{name} must hold finite numbers, {expected}, got {value!r}.")
    return array


def read_stds(name: str, value: Any, width: int) -> tuple[float, ...]:
    """A standard deviation for each of `width` states, from one number for all or one for each."""
    stds = read_array(name, value, (), (width,))
    if (stds < 0).any():
        raise InputError(f"{name} must not be negative, got {value!r}.")
    return tuple(np.broadcast_to(stds, (width,)).tolist())
