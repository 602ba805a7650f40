"""A linear regulator about the upright state, found by Riccati, and the switch to it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_discrete_are

from mcpilco.plant import Plant

UPRIGHT = np.array([np.pi, 0.0, 0.0, 0.0])
"""shoulder angle and velocity, elbow angle and velocity [rad, rad/s]"""
STATE_COST, INPUT_COST = (10.0, 0.1, 10.0, 0.1), 1.0
"""weights of squared states [1/rad^2, s^2/rad^2] and torque [1/(N m)^2]"""
NUDGE = 1e-4
"""of finite differences about the upright state [rad, rad/s, N m]"""

State = Float[np.ndarray, " 4"]
Act = Callable[[State], float]


class Regulator:
    """u = -K (x - x_up), and the region in which it may be trusted."""

    def __init__(self, plant: Plant, dt: float, limit: float, room: float = 1.0) -> None:
        """The regulator of a plant with one input, which is held for dt [s].

        It is trusted where x' P x < c: within, no torque exceeds `room` times its `limit` [N m].
        P is that of the Riccati equation, c the largest such level.
        """
        A, B = _linearised(plant, dt)
        Q, R = np.diag(STATE_COST), np.array([[INPUT_COST]])
        self.P = solve_discrete_are(A, B, Q, R)
        self.K = np.linalg.solve(R + B.T @ self.P @ B, B.T @ self.P @ A)[0]
        self.level = (room * limit) ** 2 / float(self.K @ np.linalg.solve(self.P, self.K))
        self.limit = limit

    def trusted(self, state: State, levels: float = 1.0) -> bool:
        """Whether the state is in the region, or in one of some times its level."""
        error = _error(state)
        return bool(error @ self.P @ error < levels * self.level)

    def __call__(self, state: State) -> float:
        return float(np.clip(-self.K @ _error(state), -self.limit, self.limit))


class Switched:
    """A policy that acts once in a while, and the regulator where that is trusted."""

    def __init__(self, policy: Act, regulator: Regulator | None, every: int) -> None:
        """`policy` acts at the first of `every` calls, and its torque is held for the others.

        Once trusted, the regulator acts until the state has left four times its level.
        """
        self.policy, self.regulator, self.every = policy, regulator, every
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self._waits, self._held, self.regulated = 0, 0.0, False

    def __call__(self, state: State) -> float:
        regulator = self.regulator
        if regulator is not None:
            self.regulated = regulator.trusted(state, 4.0 if self.regulated else 1.0)
            if self.regulated:
                self._waits = 0
                return regulator(state)
        if self._waits == 0:
            self._waits, self._held = self.every, self.policy(state)
        self._waits -= 1
        return self._held


def _error(state: State) -> State:
    error = state - UPRIGHT
    error[::2] = (error[::2] + np.pi) % (2.0 * np.pi) - np.pi
    return error


def _linearised(
    plant: Plant, dt: float
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "4 1"]]:
    """A and B of the step about the upright state, by central differences."""
    steps = NUDGE * np.concatenate([np.eye(5), -np.eye(5)])
    start, inputs = UPRIGHT + steps[:, :4], steps[:, None, 4:]
    after = plant.simulate(start, inputs, dt)[:, -1]
    slopes = (after[:5] - after[5:]) / (2.0 * NUDGE)
    return slopes[:4].T, slopes[4:].T
