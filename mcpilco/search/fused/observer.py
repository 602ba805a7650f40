"""The sensor and the estimator of a time step, compiled: what the policy is told of the states.

    y = C x + e,    x^ = x- + K (y - C x-),    the next x- = A x^

All of it is linear, so the way back needs no numbers of the way forward.
"""

from __future__ import annotations

from numba import njit

from mcpilco.search.fused.arithmetic import ONCE, PLAIN


@njit(**PLAIN)
def _add_product(matrix, rows, out, sign):
    """out += sign matrix rows."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            factor = sign * matrix[i, j]
            for p in range(rows.shape[1]):
                out[i, p] += factor * rows[j, p]


@njit(**PLAIN)
def _add_transposed(matrix, rows, out, sign):
    """out += sign matrix^T rows."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            factor = sign * matrix[i, j]
            for p in range(rows.shape[1]):
                out[j, p] += factor * rows[i, p]


@njit(**PLAIN)
def clear(rows):
    """Zeros."""
    for i in range(rows.shape[0]):
        for p in range(rows.shape[1]):
            rows[i, p] = 0.0


@njit(**ONCE)
def expect_start(observer, memory):
    """What is expected of a block of particles before they are measured."""
    for i in range(memory.expected.shape[0]):
        for p in range(memory.expected.shape[1]):
            memory.expected[i, p] = observer.start[i]


@njit(**ONCE)
def estimate(observer, step, errors, state, memory, estimates):
    """Estimates of the states of a block, from measurements with these errors."""
    expected, surprise = memory.expected, memory.surprise
    for i in range(surprise.shape[0]):
        for p in range(surprise.shape[1]):
            surprise[i, p] = errors[i, p]
    one = expected.dtype.type(1.0)
    _add_product(observer.C, state, surprise, one)
    _add_product(observer.C, expected, surprise, -one)
    for i in range(expected.shape[0]):
        for p in range(expected.shape[1]):
            estimates[i, p] = expected[i, p]
    _add_product(observer.gains[step], surprise, estimates, one)
    clear(expected)
    _add_product(observer.A, estimates, expected, one)


@njit(**ONCE)
def through_estimate(observer, step, memory, current):
    """From the estimates, and what is expected of the next step, to the states, which are added to.

    `memory.expected` holds the derivative by the next x-, and then that by this one.
    """
    expected, surprise, estimates = memory.expected, memory.surprise, memory.estimates
    one = expected.dtype.type(1.0)
    _add_transposed(observer.A, expected, estimates, one)
    clear(surprise)
    _add_transposed(observer.gains[step], estimates, surprise, one)
    for i in range(expected.shape[0]):
        for p in range(expected.shape[1]):
            expected[i, p] = estimates[i, p]
    _add_transposed(observer.C, surprise, expected, -one)
    _add_transposed(observer.C, surprise, current, one)
