"""A linear regulator about the upright state, found by Riccati, and where it acts."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numba import njit
from scipy.linalg import solve_discrete_are

from mcpilco.plant import Plant

UPRIGHT = np.array([np.pi, 0.0, 0.0, 0.0])
"""shoulder angle and velocity, elbow angle and velocity [rad, rad/s]"""
STATE_COST, INPUT_COST = (1.0, 1.0, 1.0, 1.0), 1.0
"""weights of squared states [1/rad^2, s^2/rad^2] and torque [1/(N m)^2]"""
ROOM = 6.3
"""torque that the regulator may ask for in its region, to the limit, at which it is cut off [-]"""
NUDGE = 1e-4
"""of finite differences about the upright state [rad, rad/s, N m]"""

State = Float[np.ndarray, " 4"]
Act = Callable[[State], float]


class Regulator:
    """u = -K (x - x_up), and the region in which it may be trusted."""

    def __init__(
        self,
        plant: Plant,
        dt: float,
        limit: float,
        room: float = ROOM,
        state_cost: tuple[float, ...] = STATE_COST,
    ) -> None:
        """The regulator of a plant with one input, which is held for dt [s].

        Its region is x' P x < c: within, it asks for no more than `room` times the `limit` [N m].
        P is that of the Riccati equation, c the largest such level.
        """
        A, B = _linearised(plant, dt)
        Q, R = np.diag(state_cost), np.array([[INPUT_COST]])
        self.P = solve_discrete_are(A, B, Q, R)
        self.K = np.linalg.solve(R + B.T @ self.P @ B, B.T @ self.P @ A)[0]
        self.level = (room * limit) ** 2 / float(self.K @ np.linalg.solve(self.P, self.K))
        self.limit, self.room, self.dt = limit, room, dt

    def __call__(self, state: State) -> tuple[float, float]:
        """Its share [-] and its torque [N m].

        The share is 1 to half of the way to the edge of the region, 0 from there on, and falls
        evenly between: so the torque never jumps.
        """
        squared, torque = pull(state, self.P, self.K)
        share = 2.0 - 2.0 * math.sqrt(squared / self.level)
        return min(max(share, 0.0), 1.0), min(max(torque, -self.limit), self.limit)


def blended(policy: Act, regulator: Regulator | None, state: State) -> float:
    """The torque of the policy, and of the regulator by its share [N m]."""
    if regulator is None:
        return policy(state)
    share, torque = regulator(state)
    return torque if share == 1.0 else share * torque + (1.0 - share) * policy(state)


@njit(cache=True)
def wrapped(state: State) -> State:
    """The error from upright; a turn more is the same place."""
    error = state - UPRIGHT
    for i in range(0, 4, 2):
        error[i] = (error[i] + np.pi) % (2.0 * np.pi) - np.pi
    return error


@njit(cache=True)
def pull(
    state: State, P: Float[np.ndarray, "4 4"], K: Float[np.ndarray, " 4"]
) -> tuple[float, float]:
    """x' P x and -K x of the error from upright."""
    error = wrapped(state)
    return error @ P @ error, -(K @ error)


def _linearised(
    plant: Plant, dt: float
) -> tuple[Float[np.ndarray, "4 4"], Float[np.ndarray, "4 1"]]:
    """A and B of the step about the upright state, by central differences."""
    steps = NUDGE * np.concatenate([np.eye(5), -np.eye(5)])
    start, inputs = UPRIGHT + steps[:, :4], steps[:, None, 4:]
    after = plant.simulate(start, inputs, dt)[:, -1]
    slopes = (after[:5] - after[5:]) / (2.0 * NUDGE)
    return slopes[:4].T, slopes[4:].T
