"""What stands between the states and the policy, as the compiled loops see it.

What is None is not even compiled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mcpilco.sensing import Foresight, LinearObserver


class ObserverArrays(NamedTuple):
    """A sensor and a linear estimator; without steps where the policy sees the states."""

    A: np.ndarray
    """(X, X), from an estimate to what is expected of the next step"""
    C: np.ndarray
    """(Y, X), from a state to its measurement"""
    gains: np.ndarray
    """(T, X, Y)"""
    start: np.ndarray
    """(X,), what is expected before any measurement"""
    errors: np.ndarray
    """(T, Y, P), of the measurements"""


class ForesightArrays(NamedTuple):
    """What a policy is told where it acts on what a model expects of the states.

    K things move in a step: the states, and behind them what is expected of them by the
    measurements of 0, 1, ... K - 2 steps before.
    """

    errors: np.ndarray
    """(T, X, P), of the measurements"""
    ahead: int
    """K - 1, steps from a measurement to the state that a policy is told"""


class SeeingArrays(NamedTuple):
    """One of them, or none where the policy sees the states."""

    observer: ObserverArrays | None
    foresight: ForesightArrays | None

    @property
    def moved(self) -> int:
        """K, how many things move in a step."""
        return 1 if self.foresight is None else self.foresight.ahead + 1

    @property
    def kept(self) -> int:
        """How many rows of X numbers a particle has."""
        return 1 if self.foresight is None else self.moved + 1


class ObserverMemory(NamedTuple):
    """What the estimator needs for one block of particles, on the way forward or back."""

    z: np.ndarray
    """(Z, P), the augmented states where those of the policy are of estimates"""
    expected: np.ndarray
    """(X, P), x- of the next step, or the derivative by it"""
    surprise: np.ndarray
    """(Y, P), y - C x-, or the derivative by it"""
    estimates: np.ndarray
    """(X, P), the derivative by them"""


class ForesightMemory(NamedTuple):
    """What foresight needs for one block of particles, on the way forward or back."""

    z: np.ndarray
    """(Z, P), the augmented states where those of the policy are of what is expected"""
    following: np.ndarray
    """((K + 1) X, P), the derivative by the next states and by what is expected of them"""
    current: np.ndarray
    """((K + 1) X, P), by the states and by what is expected of them"""


def seeing_arrays(
    observer: LinearObserver | Foresight | None, noise: np.ndarray | None
) -> SeeingArrays:
    """The arrays of an observer.

    Args:
        observer: what the policy acts behind; None: it sees the states.
        noise: standard normal numbers of its measurements, (T, Y, P).
    """
    if observer is None or noise is None:
        return SeeingArrays(None, None)
    if isinstance(observer, LinearObserver):
        return SeeingArrays(_observer(observer, noise), None)
    std = observer.noise_std.numpy().astype(noise.dtype)
    foresight = ForesightArrays(std[:, None] * noise, observer.delay.memory)
    return SeeingArrays(None, foresight)


def _observer(observer: LinearObserver, noise: np.ndarray) -> ObserverArrays:
    estimator = observer.estimator
    gains = estimator.gains.numpy()
    steps = np.minimum(np.arange(len(noise)), len(gains) - 1)
    A, C, gains, start, std = (
        np.ascontiguousarray(array, dtype=noise.dtype)
        for array in (estimator.A, estimator.C, gains[steps], estimator.start, observer.noise_std)
    )
    return ObserverArrays(A, C, gains, start, std[:, None] * noise)


def seeing_memory(
    seeing: SeeingArrays, z_width: int, width: int
) -> tuple[ObserverMemory | None, ForesightMemory | None]:
    """Fresh memory for blocks of this width."""
    return _observer_memory(seeing.observer, z_width, width), _foresight_memory(
        seeing.foresight, z_width, width
    )


def _observer_memory(
    observer: ObserverArrays | None, z_width: int, width: int
) -> ObserverMemory | None:
    if observer is None:
        return None
    states, measured = len(observer.start), len(observer.C)
    z, expected, surprise, estimates = (
        np.empty((rows, width), observer.A.dtype) for rows in (z_width, states, measured, states)
    )
    return ObserverMemory(z, expected, surprise, estimates)


def _foresight_memory(
    foresight: ForesightArrays | None, z_width: int, width: int
) -> ForesightMemory | None:
    if foresight is None:
        return None
    rows = foresight.errors.shape[1] * (foresight.ahead + 2)
    z, following, current = (
        np.empty((count, width), foresight.errors.dtype) for count in (z_width, rows, rows)
    )
    return ForesightMemory(z, following, current)
