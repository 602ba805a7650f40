"""The boards' RealAI score of a motion from hanging, blurred a little, and its slopes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from realaigym.motion import ALL, OURS, Rows, away
from realaigym.regulator import Regulator, wrapped

HEIGHT, BLUR = 0.45, 0.01
"""of the tip, above which the boards call it up; over which that goes from 0 to 1 here [m]"""
BLUNT = 0.1
"""power below which its size is about its square [W]"""
LENGTHS = 0.2, 0.3
"""of the links [m]"""
SCALES = np.array([20.0, 60.0, 20.0, 0.1, 400.0])
"""of the score's parts: swing-up time, energy, torque cost, its jumps, velocity cost"""
FALLEN = 0.1
"""weight of the distance from the top at the end, to the edge of no torque cut off [-]"""
Torques = Float[np.ndarray, " T"]


def cost(states: Rows, torques: Torques, regulator: Regulator, joint: int) -> float:
    """1 less the RealAI score, of a blurred time, and the distance from the top at the end [-]."""
    return cost_and_slopes(states, torques, regulator, joint)[0]


def cost_and_slopes(
    states: Rows, torques: Torques, regulator: Regulator, joint: int
) -> tuple[float, Rows, Torques]:
    """The `cost` of a motion, and its derivatives by each state and each torque.

    Args:
        states: of the boards' order, from hanging, one more than torques [rad, rad/s].
        torques: of the joint with the motor [N m].
        regulator: whose region is the top, and whose step is that of the motion.
        joint: which has the motor.
    """
    dt, moved, jumps = regulator.dt, np.diff(states[:, joint]), np.diff(torques)
    below, below_by_angles = _below(states)
    blunt = np.sqrt(np.square(moved * torques) + (BLUNT * dt) ** 2)
    by_work = moved * torques / blunt
    rough = np.sqrt(np.square(jumps).sum() / ALL)
    squares = dt * np.array([np.square(torques).sum(), np.square(states[:, 2:]).sum()])
    parts = [dt * below.sum(), blunt.sum(), squares[0], rough, squares[1]]
    squashed = np.tanh(np.pi * np.array(parts) / SCALES)
    # d mean(tanh(pi p / s)) / dp
    time, energy, torque, jump, velocity = (1.0 - squashed**2) * np.pi / SCALES / len(SCALES)
    by_states, by_torques = np.zeros_like(states), 2.0 * dt * torque * torques
    by_states[:, :2] = dt * time * below_by_angles
    by_states[:, 2:] = 2.0 * dt * velocity * states[:, 2:]
    by_states[1:, joint] += energy * by_work * torques
    by_states[:-1, joint] -= energy * by_work * torques
    by_torques += energy * by_work * moved
    by_jumps = jump * jumps / (ALL * max(rough, 1e-12))
    by_torques[1:] += by_jumps
    by_torques[:-1] -= by_jumps
    fallen, by_end = _fallen(states[-1], regulator)
    by_states[-1] += by_end
    return float(squashed.mean() + fallen), by_states, by_torques


def _below(states: Rows) -> tuple[Float[np.ndarray, " N"], Float[np.ndarray, "N 2"]]:
    """1 below the height of the boards and 0 above, over a blur; derivatives by the angles."""
    upper, lower = states[:, 0], states[:, 0] + states[:, 1]
    tip = -LENGTHS[0] * np.cos(upper) - LENGTHS[1] * np.cos(lower)
    below = 1.0 / (1.0 + np.exp((tip - HEIGHT) / BLUR))
    by_tip = -below * (1.0 - below) / BLUR
    by_lower = by_tip * LENGTHS[1] * np.sin(lower)
    return below, np.stack([by_tip * LENGTHS[0] * np.sin(upper) + by_lower, by_lower], -1)


def _fallen(
    state: Float[np.ndarray, " 4"], regulator: Regulator
) -> tuple[float, Float[np.ndarray, " 4"]]:
    """The cost of an end away from the top, and its derivatives."""
    distance = away(state, regulator)
    error = wrapped(state[OURS])
    slopes = 2.0 * FALLEN * regulator.room**2 / regulator.level * (regulator.P @ error)
    return FALLEN * np.log1p(distance), slopes[OURS] / (1.0 + distance)
