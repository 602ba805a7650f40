"""A pendulum behind an actuator, followed by scipy from jump to jump."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

MASS, LENGTH, FRICTION, GRAVITY = 0.6, 0.5, 0.05, 9.82


@dataclass(frozen=True)
class Motion:
    """Of states [q, q']."""

    pieces: list
    """a dense solution for each stretch between two jumps"""

    def at(self, time: float) -> np.ndarray:
        """The state at a time; before the start, the start."""
        time = max(time, 0.0)
        piece = next(p for p in self.pieces if time <= p.t_max + 1e-12)
        return piece(time)[:2]


def pendulum_motion(
    start: np.ndarray,
    forces: np.ndarray,
    dt: float,
    *,
    law: Callable[[float, float], float] = lambda q, v: 0.0,
    delay: float = 0.0,
    lag: float = 0.0,
) -> Motion:
    """The motion under forces held for dt each, that come `delay` late and through a lag.

    Args:
        start: [q, q'] [rad, rad/s].
        forces: behind everything in the actuator that has no memory of time [N m].
        dt: sampling time [s].
        law: a further force in the joint, of q and q' [N m].
        delay: [s].
        lag: [s].
    """
    end = len(forces) * dt
    grid = np.arange(len(forces)) * dt
    jumps = np.unique(np.concatenate([[0.0], grid, grid + delay, [end]]).round(12))
    jumps = jumps[jumps <= end + 1e-12]
    pieces, state = [], np.array([*start, forces[0]])
    for a, b in pairwise(jumps):
        late = int(np.floor((0.5 * (a + b) - delay) / dt))
        goal = forces[max(late, 0)]
        if lag == 0.0:
            state[2] = goal

        def rates(_, y, goal=goal):
            q, v, x = y
            tau = x - FRICTION * v - MASS * GRAVITY * LENGTH * np.sin(q) + law(q, v)
            return [v, tau / (MASS * LENGTH**2), (goal - x) / lag if lag else 0.0]

        done = solve_ivp(
            rates, (a, b), state, method="LSODA", rtol=1e-10, atol=1e-12, dense_output=True
        )
        pieces.append(done.sol)
        state = done.y[:, -1].copy()
    return Motion(pieces)
