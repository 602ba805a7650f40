"""What a policy is told where a model foresees the states in which inputs act, compiled.

    x~_0 = x + e,    told: x~_d

The rows of a particle are [x, x~_0, ... x~_d]; the loops move x~_0, x~_1, ... as they move x,
without noise.
"""

from __future__ import annotations

from numba import njit

from mcpilco.search.fused.arithmetic import ONCE


@njit(**ONCE)
def foresee(errors, rows, told):
    """The measurements of a block, among its rows, and what a policy is told of its states."""
    width, last = errors.shape[0], rows.shape[0] - errors.shape[0]
    for i in range(width):
        for p in range(errors.shape[1]):
            rows[width + i, p] = rows[i, p] + errors[i, p]
    for i in range(width):
        for p in range(errors.shape[1]):
            told[i, p] = rows[last + i, p]


@njit(**ONCE)
def through_foresight(rows, current):
    """From the measurements to the states, which are added to; all derivatives."""
    width = current.shape[0]
    for i in range(width):
        for p in range(current.shape[1]):
            current[i, p] += rows[width + i, p]
            rows[width + i, p] = 0.0
