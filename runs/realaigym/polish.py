"""A policy's motion from hanging, polished to the boards' RealAI score in the model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numba import njit
from realaigym.equations import Row, State, step
from realaigym.regulator import Regulator, pull
from scipy.optimize import minimize

ROOM = 3.0
"""of the regulator behind the thrifty policy [-]: it enters late, and gently"""
STEPS = 1250
"""of the motion that is polished, of 0.002 s: 2.5 s"""
ALL = 5000
"""of the boards' motion, in the rest of which a pendulum that stands costs nothing"""
HEIGHT, BLUR = 0.45, 0.01
"""of the tip, above which the boards call it up; over which that goes from 0 to 1 here [m]"""
LENGTHS = 0.2, 0.3
"""of the links [m]"""
SCALES = np.array([20.0, 60.0, 20.0, 0.1, 400.0])
"""of the score's parts: swing-up time, energy, torque cost, its jumps, velocity cost"""
FALLEN = 0.1
"""weight of the distance from the top at the end, to the edge of no torque cut off [-]"""
FARTHEST = 10.0
"""largest such distance [-]"""
NUDGE = 1e-4
"""of finite differences, to the mean size of a weight [-]"""

HANGING = np.zeros(4)
TRIED, SPREAD = 100, np.array([1.5, 1.5, 4.0, 6.0])
"""starts from which a robust policy is tried, and their std about hanging [rad, rad/s]"""
AT_REST = 1e-3
"""least x' P x, to the edge of no torque cut off, of a pendulum that stands [-]"""

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

    def __call__(self, state: State) -> float:
        """The torque in a state of our order: each angle before its velocity [N m]."""
        return _torque(state, self.centres, self.scales, self.weights, self.squash, self.limit)


def polished(
    file: Path, regulator: Regulator, plant: Row, joint: int, iterations: int
) -> tuple[Path, float]:
    """Quasi-Newton steps of a policy's weights: the new file, and the score in the model [-].

    The gradient is that of finite differences through the loop of plant, policy and regulator.
    """
    first = Gaussians.read(file)
    size = np.abs(first.weights).mean()

    def cost(weights: Float[np.ndarray, " B"]) -> float:
        policy = replace(first, weights=weights)
        return _cost(*motion(policy, regulator, plant, joint, STEPS), regulator, joint)

    def cost_and_slopes(moves: Float[np.ndarray, " B"]) -> tuple[float, Float[np.ndarray, " B"]]:
        weights = first.weights + size * moves
        here, nudges = cost(weights), NUDGE * size * np.eye(len(weights))
        return here, np.array([cost(weights + nudge) - here for nudge in nudges]) / NUDGE

    options: dict[str, Any] = {"maxiter": iterations}
    still = np.zeros_like(first.weights)
    found = minimize(cost_and_slopes, still, jac=True, method="L-BFGS-B", options=options)
    with np.load(file) as old:
        arrays = dict(old)
    weights = first.weights + size * found.x
    into = file.with_name(f"{file.stem}-polished.npz")
    np.savez(into, **{**arrays, "weights": weights[:, None]})
    return into, 1.0 - cost(weights)


def upright(file: Path, regulator: Regulator, plant: Row, joint: int) -> float:
    """The share of motions in the model that end upright; a quarter starts near hanging [-]."""
    policy, starts = Gaussians.read(file), np.random.default_rng(0).normal(size=(TRIED, 4)) * SPREAD
    starts[: TRIED // 4] *= 0.01
    ends = [motion(policy, regulator, plant, joint, ALL, start)[0][-1] for start in starts]
    return float(np.mean([_away(end, regulator) < AT_REST for end in ends]))


def motion(
    policy: Gaussians,
    regulator: Regulator,
    plant: Row,
    joint: int,
    steps: int,
    start: State = HANGING,
) -> tuple[Rows, Float[np.ndarray, " T"]]:
    """States in the boards' order, one more than torques [N m], of a motion; from hanging."""
    p, r = policy, regulator
    parts = p.centres, p.scales, p.weights, p.squash, p.limit, r.P, r.K, r.level, r.limit
    return _motion(start, steps, r.dt, joint, plant, *parts)


def _cost(
    states: Rows, torques: Float[np.ndarray, " T"], regulator: Regulator, joint: int
) -> float:
    """1 less the RealAI score, of a blurred time, and the distance from the top at the end [-]."""
    tip = -LENGTHS[0] * np.cos(states[:, 0]) - LENGTHS[1] * np.cos(states[:, 0] + states[:, 1])
    time = regulator.dt * (1.0 / (1.0 + np.exp((tip - HEIGHT) / BLUR))).sum()
    energy = np.abs(np.diff(states[:, joint]) * torques).sum()
    jumps = np.sqrt(np.square(np.diff(torques)).sum() / ALL)
    squares = regulator.dt * np.array([np.square(torques).sum(), np.square(states[:, 2:]).sum()])
    parts = np.array([time, energy, squares[0], jumps, squares[1]])
    fallen = min(_away(states[-1], regulator), FARTHEST)
    return float(np.tanh(np.pi * parts / SCALES).mean() + FALLEN * fallen)


def _away(state: State, regulator: Regulator) -> float:
    """x' P x, to its level at which the regulator is about to be cut off [-]."""
    squared, _ = pull(state[[0, 2, 1, 3]], regulator.P, regulator.K)
    return squared * regulator.room**2 / regulator.level


@njit(cache=True, fastmath=True)
def _torque(x: State, centres: Any, scales: Any, weights: Any, squash: float, limit: float) -> Any:
    cosines, sines = np.cos(x[::2]), np.sin(x[::2])
    z = np.array([x[1], x[3], cosines[0], cosines[1], sines[0], sines[1]]) / scales
    total = 0.0
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
        ours = states[t][np.array([0, 2, 1, 3])]
        squared, torque = pull(ours, P, K)
        share = min(max(2.0 - 2.0 * np.sqrt(squared / level), 0.0), 1.0)
        torque = share * min(max(torque, -regulated_limit), regulated_limit)
        if share < 1.0:
            torque += (1.0 - share) * _torque(ours, centres, scales, weights, squash, limit)
        torques[t] = torque
        u1, u2 = (torque, 0.0) if joint == 0 else (0.0, torque)
        states[t + 1] = step(states[t], u1, u2, plant, dt)
    return states, torques
