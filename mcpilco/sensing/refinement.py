"""Recordings smoothed by the model that was learned from them: its forces are known, then.

The first smoother knows of no forces: a velocity wanders. A model that was fitted to what it makes
of the recordings knows more of them, and smoothed by it they teach a better model.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from mcpilco.dynamics import linearised_along
from mcpilco.sensing.motion import corrected
from mcpilco.task import TaskSpec

RELINEARISED = 3
"""times that a motion is smoothed along the one before"""
FARTHEST = 3.0
"""rms of the measurements' distances from a motion, in noise std, beyond which it is none of it"""


def refined(
    task: TaskSpec,
    dynamics: Any,
    noise_std: Float[np.ndarray, " Y"],
    measured: Float[np.ndarray, "T_plus_1 Y"],
    inputs: Float[np.ndarray, "T U"],
    states: Float[np.ndarray, "T_plus_1 X"],
) -> Float[np.ndarray, "T_plus_1 X"]:
    """The likeliest states of a recording by a model, from those that are known of it so far.

    These stay where the model leads away from what was measured, as one of few data may.

    Args:
        task: which states are measured, and how episodes start.
        dynamics: the model of the next state.
        noise_std: of each measurement, in its unit.
        measured: in each measurement's unit.
        inputs: that were applied.
        states: about which the model is linear at first, in each state's unit.

    Reference: Bell, The iterated Kalman smoother as a Gauss-Newton method, SIAM Journal on
        Optimization 4 (3), 1994; Sarkka, Bayesian Filtering and Smoothing, 2013, section 9.1.
    """
    C = np.eye(states.shape[1])[list(task.measured_states)]
    start, spread = np.array(task.start_mean), np.diag(np.square(task.start_std))
    known = states
    try:
        for _ in range(RELINEARISED):
            after, A, W = linearised_along(dynamics, states[:-1], inputs)
            W = W + np.diag(_within_steps(task, states) ** 2)
            mean, P = start, spread
            means, covariances, ahead = [], [], []
            for t, y in enumerate(measured):
                gain, _, P = corrected(P, C, noise_std)
                mean = mean + gain @ (y - C @ mean)
                means.append(mean)
                covariances.append(P)
                if t < len(inputs):
                    mean, P = after[t] + A[t] @ (mean - states[t]), A[t] @ P @ A[t].T + W[t]
                    ahead.append((mean, P))
            states = np.array(means)
            for t in reversed(range(len(inputs))):
                expected, P = ahead[t]
                G = np.linalg.solve(P, A[t] @ covariances[t]).T
                states[t] += G @ (states[t + 1] - expected)
    except np.linalg.LinAlgError:
        return known
    off = np.sqrt(np.mean(((measured - states @ C.T) / noise_std) ** 2))
    return states if off < FARTHEST else known  # not where it is no number


def _within_steps(
    task: TaskSpec, states: Float[np.ndarray, "T_plus_1 X"]
) -> Float[np.ndarray, " X"]:
    """Std of what an acceleration that changes within a step adds to each state, in its unit.

    The trapezoid of the velocities misses dt^2 / 12 times the change of the acceleration.
    """
    std = np.zeros(states.shape[1])
    for position, velocity in task.velocities:
        bends = np.diff(states[:, velocity], 2)
        std[position] = task.dt / 12 * np.sqrt(np.mean(bends**2)) if len(bends) else 0.0
    return std
