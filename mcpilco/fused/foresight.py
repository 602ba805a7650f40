"""What a policy is told where a model foresees the states in which inputs act, compiled.

    x~_0 = x + e,    told: sum_k share_k x~_k

The rows of a particle are [x, x~_0, x~_1, ...]; the loops move x~_0, x~_1, ... as they move x,
without noise.
"""

from __future__ import annotations

from numba import njit

from mcpilco.fused.arithmetic import ONCE


@njit(**ONCE)
def foresee(foresight, errors, rows, told):
    """The measurements of a block, among its rows, and what a policy is told of its states."""
    shares, width = foresight.shares, errors.shape[0]
    for i in range(width):
        for p in range(errors.shape[1]):
            rows[width + i, p] = rows[i, p] + errors[i, p]
            told[i, p] = 0.0
    for k in range(shares.size):
        for i in range(width):
            for p in range(errors.shape[1]):
                told[i, p] += shares[k] * rows[(k + 1) * width + i, p]


@njit(**ONCE)
def through_foresight(foresight, told, rows, current):
    """From what a policy is told to the rows, and from the measurements to the states.

    All derivatives; the rows of what is expected are added to, and then those of the measurements
    to the states.
    """
    shares, width = foresight.shares, current.shape[0]
    for k in range(shares.size):
        for i in range(width):
            for p in range(current.shape[1]):
                rows[(k + 1) * width + i, p] += shares[k] * told[i, p]
    for i in range(width):
        for p in range(current.shape[1]):
            current[i, p] += rows[width + i, p]
            rows[width + i, p] = 0.0
