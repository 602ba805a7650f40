"""Motions of policy, regulator and plant at the boards' 500 Hz, compiled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numba import njit
from realaigym.equations import Row, State, step
from realaigym.regulator import Regulator, pull

ALL = 5000
"""steps of the boards' motion: 10 s"""
HANGING = (0.0, 0.0, 0.0, 0.0)
TRIED, SPREAD = 100, np.array([1.5, 1.5, 4.0, 6.0])
"""starts from which a robust policy is tried, and their std about hanging [rad, rad/s]"""
AT_REST = 1e-3
"""least x' P x, to the edge of no torque cut off, of a pendulum that stands [-]"""
OURS = np.array([0, 2, 1, 3])
"""where our states are among the boards', which have the angles first; and theirs among ours"""

Rows = Float[np.ndarray, "N 4"]


@dataclass(frozen=True)
class Gaussians:
    """A sum of Gaussians as `write_policy` stores it, of our double pendulums."""

    centres: Float[np.ndarray, "B 6"]
    """over the lengthscales [-]"""
    scales: Float[np.ndarray, " 6"]
    """lengthscales of both velocities, cosines and sines [rad/s, -]"""
    weights: Float[np.ndarray, " B"]
    squash: float
    limit: float
    """largest torque [N m]"""

    @classmethod
    def read(cls, path: Path) -> Gaussians:
        """The policy of a file."""
        with np.load(path) as file:
            scales = file["lengthscales"].ravel()
            numbers = float(file["squash"]), float(file["half_range"][0])
            return cls(file["centres"] / scales, scales, file["weights"][:, 0].copy(), *numbers)

    def write(self, path: Path, like: Path) -> None:
        """The policy as a file, the rest of which is that of another file."""
        with np.load(like) as file:
            arrays = dict(file)
        arrays["lengthscales"] = self.scales.reshape(arrays["lengthscales"].shape)
        arrays["centres"] = self.centres * self.scales
        arrays["weights"] = self.weights[:, None]
        np.savez(path, **arrays)

    def __call__(self, state: State) -> float:
        """The torque in a state of our order: each angle before its velocity [N m]."""
        return _torque(state, self.centres, self.scales, self.weights, self.squash, self.limit)


def motion(
    policy: Gaussians,
    regulator: Regulator,
    plant: Row,
    joint: int,
    steps: int,
    start: Sequence[float] | State = HANGING,
) -> tuple[Rows, Float[np.ndarray, " T"]]:
    """States in the boards' order, one more than torques [N m], of a motion; from hanging."""
    return _motion(np.array(start), steps, regulator.dt, joint, plant, *numbers(policy, regulator))


def numbers(policy: Gaussians, regulator: Regulator) -> tuple[Any, ...]:
    """The numbers of both, as compiled functions take them."""
    p, r = policy, regulator
    return p.centres, p.scales, p.weights, p.squash, p.limit, r.P, r.K, r.level, r.limit


def away(state: State, regulator: Regulator) -> float:
    """x' P x, to its level at which the regulator is about to be cut off [-]."""
    squared, _ = pull(state[OURS], regulator.P, regulator.K)
    return squared * regulator.room**2 / regulator.level


def upright(file: Path, regulator: Regulator, plant: Row, joint: int) -> float:
    """The share of motions in the model that end upright; a quarter starts near hanging [-]."""
    policy, starts = Gaussians.read(file), np.random.default_rng(0).normal(size=(TRIED, 4)) * SPREAD
    starts[: TRIED // 4] *= 0.01
    ends = [motion(policy, regulator, plant, joint, ALL, start)[0][-1] for start in starts]
    return float(np.mean([away(end, regulator) < AT_REST for end in ends]))


@njit(cache=True)
def features(x: State, scales: Any) -> Any:
    """Both velocities, cosines and sines of a state of our order, over their lengthscales."""
    cosines, sines = np.cos(x[::2]), np.sin(x[::2])
    return np.array([x[1], x[3], cosines[0], cosines[1], sines[0], sines[1]]) / scales


@njit(cache=True, fastmath=True)
def _torque(x: State, centres: Any, scales: Any, weights: Any, squash: float, limit: float) -> Any:
    z, total = features(x, scales), 0.0
    for centre, weight in zip(centres, weights):  # noqa: B905 numba knows no strict
        apart = 0.0
        for i in range(6):
            apart += (z[i] - centre[i]) ** 2
        total += weight * np.exp(-apart)
    return limit * np.tanh(total / squash)


@njit(cache=True, fastmath=True)
def _motion(
    start: State,
    steps: int,
    dt: float,
    joint: int,
    plant: Any,
    centres: Any,
    scales: Any,
    weights: Any,
    squash: float,
    limit: float,
    P: Any,
    K: Any,
    level: float,
    regulated_limit: float,
) -> Any:
    states, torques = np.zeros((steps + 1, 4)), np.zeros(steps)
    states[0] = start
    for t in range(steps):
        ours = states[t][OURS]
        squared, torque = pull(ours, P, K)
        share = min(max(2.0 - 2.0 * np.sqrt(squared / level), 0.0), 1.0)
        torque = share * min(max(torque, -regulated_limit), regulated_limit)
        if share < 1.0:
            torque += (1.0 - share) * _torque(ours, centres, scales, weights, squash, limit)
        torques[t] = torque
        u1, u2 = (torque, 0.0) if joint == 0 else (0.0, torque)
        states[t + 1] = step(states[t], u1, u2, plant, dt)
    return states, torques
