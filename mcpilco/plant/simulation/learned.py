"""Forces in joints that were learned, for compiled callers: cubic B-splines on grids.

A grid has one axis or two; each is a position, a velocity or the force of an actuator. A spline has
16 terms at most at any place, whatever the grid, is twice differentiable, and is 0 beyond two steps
from the grid. An axis may be closed: behind its last knot comes its first.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit

from mcpilco.bodies import INLINED

NONE = -1
"""in the place of the second axis of a grid that has one only"""


class Learned(NamedTuple):
    """K learned forces of S systems, over [q1, q1', q2, ..., force of input 1, ...]."""

    joint: Int[np.ndarray, " K"]
    """which each pushes"""
    axis: Int[np.ndarray, "K 2"]
    """what its grid is over"""
    slow: Float[np.ndarray, "K 2"]
    """where positive, the grid is even in asinh(x / slow)"""
    low: Float[np.ndarray, "K 2"]
    """of the first knot"""
    step: Float[np.ndarray, "K 2"]
    """from knot to knot"""
    knots: Int[np.ndarray, "K 2"]
    """of each axis"""
    closed: Bool[np.ndarray, "K 2"]
    """whether the first knot comes again, a step behind the last one"""
    weights: Float[np.ndarray, "S K M"]
    """of the splines, by first and second axis [N or N m]"""


def nothing(systems: int) -> Learned:
    """Of systems without learned forces."""
    pairs, counts = np.zeros((0, 2)), np.zeros((0, 2), dtype=np.int64)
    joint, closed = np.zeros(0, dtype=np.int64), np.zeros((0, 2), dtype=np.bool_)
    return Learned(joint, counts, pairs, pairs, pairs, counts, closed, np.zeros((systems, 0, 0)))


@njit(**INLINED)
def place_on(learned, k, a, x):
    """Where a coordinate is on axis a of grid k, in steps from the first knot."""
    slow = learned.slow[k, a]
    if slow > 0.0:
        x = math.asinh(x / slow)
    place = (x - learned.low[k, a]) / learned.step[k, a]
    if learned.closed[k, a]:
        place -= learned.knots[k, a] * math.floor(place / learned.knots[k, a])
    return place


@njit(**INLINED)
def spline_weight(i, s):
    """The cubic B-spline whose knot is i - 1 knots further, at 0 <= s < 1 beyond a knot."""
    if i == 0:
        return (1.0 - s) ** 3 / 6.0
    if i == 1:
        return (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0
    if i == 2:
        return (-3.0 * s * s * s + 3.0 * s * s + 3.0 * s + 1.0) / 6.0
    return s * s * s / 6.0


@njit(**INLINED)
def learned_force(learned, s, k, x, y):
    """Force of grid k at x and y, steps from the first knots; y is 0 where there is one axis."""
    n, m = learned.knots[k, 0], learned.knots[k, 1]
    if not (-2.0 < x < n + 1.0 and -2.0 < y < m + 1.0):
        return 0.0
    i0, j0 = math.floor(x), math.floor(y)
    total = 0.0
    for i in range(4):
        row = i0 - 1 + i
        if learned.closed[k, 0]:
            row %= n
        if 0 <= row < n:
            if learned.axis[k, 1] < 0:
                part = learned.weights[s, k, row]
            else:
                part = 0.0
                for j in range(4):
                    column = j0 - 1 + j
                    if learned.closed[k, 1]:
                        column %= m
                    if 0 <= column < m:
                        weight = learned.weights[s, k, row * m + column]
                        part += spline_weight(j, y - j0) * weight
            total += spline_weight(i, x - i0) * part
    return total
