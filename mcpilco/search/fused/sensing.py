"""Sensors and estimators between the states and the policy, compiled, and the way back.

    y = C x + e,    x^ = x- + K (y - C x-),    the next x- = A x^

for states that are measured in part, and for an actuator that answers late

    x~_0 = x^,    x~_k of the next step = f(x~_(k-1), u)

and the policy acts on x~_d. The rows of a particle are [x, x~_0, ... x~_d]: the loops move x~_0,
x~_1, ... as they move x, without noise. Where all states are measured x^ is x + e; where the
actuator is prompt d is 0. The linear part needs no numbers of the way forward on the way back.

Each function takes the sensing first. Where the policy sees the states it is None, and what is
compiled does nothing, or takes the states themselves.
"""

from __future__ import annotations

from collections import namedtuple
from dataclasses import fields
from typing import NamedTuple

import numpy as np
from numba import njit

from mcpilco.search.fused.arithmetic import PLAIN, add, clear, copy
from mcpilco.search.fused.policy import augment, through_augmentation
from mcpilco.sensing import Chain, DelayModel, LinearEstimator, Observer

LinearArrays = namedtuple("LinearArrays", [field.name for field in fields(LinearEstimator)])
"""those of a `LinearEstimator`; gains are of each of T steps"""


class SensingArrays(NamedTuple):
    """A sensor and the estimators behind it."""

    errors: np.ndarray
    """(T, Y, P), of the measurements"""
    linear: LinearArrays | None
    """None: all states are measured"""
    ahead: int
    """d, steps from a measurement to the state that a policy acts on"""


class SensingMemory(NamedTuple):
    """Memory of the estimators for one block of particles, on the way forward or back."""

    z: np.ndarray
    """(Z, P), the augmented states of a row, where those of the policy are of estimates"""
    expected: np.ndarray
    """(X, P), x- of the next step, or the derivative by it"""
    surprise: np.ndarray
    """(Y, P), y - C x-, or the derivative by it"""
    following: np.ndarray
    """((d + 2) X, P), the derivative by the next rows"""
    current: np.ndarray
    """((d + 2) X, P), by the rows"""


def parts(observer: Observer) -> tuple[LinearEstimator | None, int] | None:
    """An observer's linear estimator, if any, and its delay in steps; None where it has others."""
    estimator = observer.estimator
    chain = isinstance(estimator, Chain)
    first, second = (estimator.first, estimator.second) if chain else (estimator, None)
    if second is None and isinstance(first, DelayModel):
        first, second = None, first
    if not isinstance(first, LinearEstimator | None) or not isinstance(second, DelayModel | None):
        return None
    return first, 0 if second is None else second.delay.memory


def sensing_arrays(observer: Observer, noise: np.ndarray) -> SensingArrays:
    """The arrays of an observer that `parts` knows.

    The noise of measurements is standard normal, (T, Y, P).
    """
    known = parts(observer)
    assert known is not None, "mcpilco.search.fused.engine has made sure"
    estimator, ahead = known
    errors = observer.noise_std.numpy().astype(noise.dtype)[:, None] * noise
    if estimator is None:
        return SensingArrays(errors, None, ahead)
    gains = estimator.gains.numpy()
    steps = np.minimum(np.arange(len(noise)), len(gains) - 1)
    arrays = estimator.A, estimator.C, gains[steps], estimator.start
    linear = (np.ascontiguousarray(array, dtype=noise.dtype) for array in arrays)
    return SensingArrays(errors, LinearArrays(*linear), ahead)


def sensing_memory(
    sensing: SensingArrays | None, states: int, z_width: int, width: int
) -> SensingMemory | None:
    """Fresh memory for blocks of this width."""
    if sensing is None:
        return None
    rows = states * (sensing.ahead + 2)
    counts = z_width, states, sensing.errors.shape[1], rows, rows
    return SensingMemory(*(np.empty((count, width), sensing.errors.dtype) for count in counts))


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


# --- forward --------------------------------------------------------------------------------------


@njit(**PLAIN)
def _expect_start(linear, expected):
    if linear is None:
        return
    for i in range(expected.shape[0]):
        for p in range(expected.shape[1]):
            expected[i, p] = linear.start[i]


@njit(**PLAIN)
def begin(sensing, memory):
    """The expected states of a block of particles before they are measured."""
    if sensing is None:
        return
    _expect_start(sensing.linear, memory.expected)


@njit(**PLAIN)
def _estimate(linear, step, errors, state, memory, estimates):
    """Estimates of the states of a block, from measurements with these errors."""
    if linear is None:
        for i in range(errors.shape[0]):
            for p in range(errors.shape[1]):
                estimates[i, p] = state[i, p] + errors[i, p]
        return
    expected, surprise = memory.expected, memory.surprise
    copy(errors, surprise)
    one = expected.dtype.type(1.0)
    _add_product(linear.C, state, surprise, one)
    _add_product(linear.C, expected, surprise, -one)
    copy(expected, estimates)
    _add_product(linear.gains[step], surprise, estimates, one)
    clear(expected)
    _add_product(linear.A, estimates, expected, one)


@njit(**PLAIN)
def observe(sensing, step, first, rows, width, memory):
    """Fills x~_0 among the rows of a block, from the measurements of a step."""
    if sensing is None:
        return
    errors = sensing.errors[step, :, first : first + rows.shape[1]]
    state, estimates = rows[:width], rows[width : 2 * width]
    _estimate(sensing.linear, step, errors, state, memory, estimates)


@njit(**PLAIN)
def set_augmented(sensing, state, policy, z, x):
    """The augmented states of a row of a block, in the first rows of x; z is the policy's own."""
    if sensing is None:
        copy(z, x[: z.shape[0]])
        return
    augment(state, policy, x)


# --- backward -------------------------------------------------------------------------------------


@njit(**PLAIN)
def begin_back(sensing, memory):
    """No derivatives by what comes after the last step."""
    if sensing is None:
        return
    clear(memory.expected)
    clear(memory.current)


@njit(**PLAIN)
def enter_step(sensing, memory, adjoint):
    """The derivatives by the next rows: what were those by the rows."""
    if sensing is None:
        return
    copy(memory.current, memory.following)
    copy(adjoint.following, memory.following[: adjoint.following.shape[0]])
    clear(memory.current)


@njit(**PLAIN)
def enter_row(sensing, k, gradient, memory, adjoint):
    """The derivatives by the row that the k-th one becomes, in `following`."""
    if sensing is None:
        return
    width = adjoint.following.shape[0]
    to = (k + 1) * width if k > 0 else 0
    copy(memory.following[to : to + width], adjoint.following)
    if k > 0:
        clear(adjoint.current)
    else:
        copy(gradient, adjoint.current)


@njit(**PLAIN)
def leave_row(sensing, k, state, policy, memory, adjoint):
    """The derivatives by the k-th row, from those by its augmented state as well."""
    if sensing is None:
        return
    augment(state, policy, memory.z)
    through_augmentation(policy, memory.z, adjoint.z, adjoint.current)
    clear(adjoint.z)
    at = k * adjoint.current.shape[0]
    copy(adjoint.current, memory.current[at : at + adjoint.current.shape[0]])


@njit(**PLAIN)
def _through_estimate(linear, step, estimates, memory, current):
    """From the estimates, and the expected next states, to the states, which are added to.

    `memory.expected` holds the derivative by the next x-, and then that by this one.
    """
    if linear is None:
        add(estimates, current)
        return
    expected, surprise = memory.expected, memory.surprise
    one = expected.dtype.type(1.0)
    _add_transposed(linear.A, expected, estimates, one)
    clear(surprise)
    _add_transposed(linear.gains[step], estimates, surprise, one)
    copy(estimates, expected)
    _add_transposed(linear.C, surprise, expected, -one)
    _add_transposed(linear.C, surprise, current, one)


@njit(**PLAIN)
def add_acted_on(sensing, more, memory, adjoint):
    """Adds to the derivatives by the states that the policy saw."""
    if sensing is None:
        add(more, adjoint.current)
        return
    add(more, memory.current[memory.current.shape[0] - more.shape[0] :])


@njit(**PLAIN)
def leave_step(sensing, step, policy, z, memory, adjoint):
    """From the augmented states that the policy saw to the states, which are added to."""
    if sensing is None:
        through_augmentation(policy, z, adjoint.z, adjoint.current)
        return
    rows, width = memory.current, adjoint.current.shape[0]
    through_augmentation(policy, z, adjoint.z, rows[rows.shape[0] - width :])
    _through_estimate(sensing.linear, step, rows[width : 2 * width], memory, adjoint.current)
