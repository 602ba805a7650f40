"""Derivatives of a motion's cost by the numbers of its policy, backward in time.

With the next state f(x, u), the torque u = pi(x) of policy and regulator, and a cost c of states
and torques, lambda_t = dc/dx_t + (df/dx)' lambda_{t+1} + mu_t dpi/dx, where
mu_t = dc/du_t + (df/du)' lambda_{t+1}; and dc/dtheta = sum over t of mu_t dpi/dtheta.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from numba import njit
from realaigym.equations import State, step
from realaigym.motion import OURS, features
from realaigym.regulator import pull, wrapped

NUDGE = 1e-5
"""of the plant's central differences [rad, rad/s, N m]"""

Slopes = tuple[Float[np.ndarray, " B"], Float[np.ndarray, "B 6"], Float[np.ndarray, " 6"]]
"""by weights, by centres over the lengthscales, and by logarithms of the lengthscales"""


@njit(cache=True, fastmath=True)
def slopes(
    states: Any,
    torques: Any,
    by_states: Any,
    by_torques: Any,
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
    """The derivatives of a cost by the policy's numbers, from those by states and torques.

    Args:
        states: of the motion, in the boards' order, one more than torques.
        torques: of the joint with the motor [N m].
        by_states: of the cost, with all else held.
        by_torques: of the cost, with all else held.
        dt: time from state to state [s].
        joint: which has the motor.
        plant: its `Row`.
        centres, scales, weights, squash, limit: of the `Gaussians`.
        P, K, level, regulated_limit: of the `Regulator`.
    """
    of_weights, of_centres = np.zeros_like(weights), np.zeros_like(centres)
    of_scales, behind = np.zeros_like(scales), by_states[-1].copy()
    for t in range(len(torques) - 1, -1, -1):
        by_state, by_torque = _through_plant(states[t], torques[t], joint, plant, dt, behind)
        by_torque += by_torques[t]
        x = states[t][OURS]
        squared, asked = pull(x, P, K)
        share = min(max(2.0 - 2.0 * np.sqrt(squared / level), 0.0), 1.0)
        cut = min(max(asked, -regulated_limit), regulated_limit)
        by_x = np.zeros(4)
        if share > 0.0 and cut == asked:
            by_x -= share * K
        if share < 1.0:
            own = (1.0 - share) * by_torque
            torque, by_own = _through_policy(
                x, own, centres, scales, weights, squash, limit, of_weights, of_centres, of_scales
            )
            by_x += (1.0 - share) * by_own
            if share > 0.0:
                by_share = -2.0 / np.sqrt(squared * level) * (P @ wrapped(x))
                by_x += (cut - torque) * by_share
        behind = by_states[t] + by_state + by_torque * by_x[OURS]
    return of_weights, of_centres, of_scales


@njit(cache=True, fastmath=True)
def _through_plant(
    state: State, torque: float, joint: int, plant: Any, dt: float, behind: State
) -> Any:
    """(df/dx)' lambda and (df/du)' lambda, by central differences."""
    found = np.zeros(5)
    for i in range(5):
        ends = np.zeros((2, 4))
        for side in range(2):
            x, motors = state.copy(), np.zeros(2)
            motors[joint] = torque
            nudge = NUDGE * (1.0 - 2.0 * side)
            if i < 4:
                x[i] += nudge
            else:
                motors[joint] += nudge
            ends[side] = step(x, motors[0], motors[1], plant, dt)
        found[i] = (ends[0] - ends[1]) @ behind / (2.0 * NUDGE)
    return found[:4], found[4]


@njit(cache=True, fastmath=True)
def _through_policy(
    x: State,
    by_torque: float,
    centres: Any,
    scales: Any,
    weights: Any,
    squash: float,
    limit: float,
    of_weights: Any,
    of_centres: Any,
    of_scales: Any,
) -> Any:
    """The policy's torque and its derivatives by the state; adds those by its numbers."""
    z, total, bells = features(x, scales), 0.0, np.zeros_like(weights)
    for b in range(len(weights)):
        apart = 0.0
        for i in range(6):
            apart += (z[i] - centres[b, i]) ** 2
        bells[b] = np.exp(-apart)
        total += weights[b] * bells[b]
    squashed = np.tanh(total / squash)
    by_total = limit * (1.0 - squashed * squashed) / squash
    by_z = np.zeros(6)
    for b in range(len(weights)):
        of_weights[b] += by_torque * by_total * bells[b]
        for i in range(6):
            slope = 2.0 * by_total * weights[b] * bells[b] * (z[i] - centres[b, i])
            of_centres[b, i] += by_torque * slope
            by_z[i] -= slope
    of_scales -= by_torque * by_z * z
    by_z /= scales
    turned = by_z[4:] * np.cos(x[::2]) - by_z[2:4] * np.sin(x[::2])
    return limit * squashed, np.array([turned[0], by_z[0], turned[1], by_z[1]])
