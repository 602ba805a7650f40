"""The motion of a state whose forces are not known: its Kalman filter, and its smoother."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from mcpilco.dynamics import speed_integration
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

MOST_GAINS = 1000
"""steps after which a filter's gains are taken as constant, if they have not settled before"""
_SETTLED = 1e-12  # relative change of the gains from one step to the next
_SMALLEST_NOISE = 1e-4  # of a measurement's spread, where its noise is estimated [-]


@dataclass(frozen=True)
class Filtered:
    """Means and covariances of a Kalman filter at each step, before and after the measurement."""

    expected: Float[np.ndarray, "T X"]
    """mean of the state given all measurements before, in each state's unit"""
    expected_covariance: Float[np.ndarray, "T X X"]
    means: Float[np.ndarray, "T X"]
    """mean of the state given that measurement too"""
    covariances: Float[np.ndarray, "T X X"]
    log_likelihood: float
    """log density of all measurements [-]"""


@dataclass(frozen=True)
class Motion:
    """Speeds that wander, positions that follow from them, and a sensor with noise.

        x' = A x + w,  w ~ N(0, W);      y = C x + e,  e ~ N(0, noise_std^2)

    The acceleration is white noise, of which W is the effect in one step: with s the change_std of
    a velocity, its position and it have

        A = [1 dt]     W = s^2 [dt^2 / 3  dt / 2]
            [0  1]             [dt / 2    1     ]

    so that the smoothed position is a smoothing spline, of third degree. All else changes by a
    random step of its own.

    Reference: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation,
    2001, section 6.2.2; for the spline Wahba, Spline Models for Observational Data, 1990.
    """

    A: Float[np.ndarray, "X X"]
    shape: Float[np.ndarray, "E X X"]
    """W for each state that is no position, where its change_std is 1"""
    C: Float[np.ndarray, "Y X"]
    start_mean: Float[np.ndarray, " X"]
    """before any measurement, in each state's unit"""
    start_std: Float[np.ndarray, " X"]
    change_std: Float[np.ndarray, " E"]
    """of the change in one step of each state that is no position, in its unit"""
    noise_std: Float[np.ndarray, " Y"]
    """of each measurement, in its unit"""

    @classmethod
    def of(
        cls, task: TaskSpec, change_std: Float[np.ndarray, " E"], noise_std: Float[np.ndarray, " Y"]
    ) -> Motion:
        """The motion of a task's states."""
        law, width = speed_integration(task), len(task.state_names)
        # W = B B^T s^2, and what an acceleration that is not constant within the step adds
        shape = np.einsum("ie,je->eij", law.B, law.B)
        for position, velocity in task.velocities:
            shape[law.predicted.index(velocity), position, position] += task.dt**2 / 12
        C = np.eye(width)[list(task.measured_states)]
        start_mean, start_std = np.array(task.start_mean), np.array(task.start_std)
        return cls(law.A, shape, C, start_mean, start_std, change_std, noise_std)

    def gains(self) -> Float[np.ndarray, "G X Y"]:
        """The filter's gain at measurement 0, 1, ..., up to the one that holds from there on.

        They do not depend on the measurements.
        """
        covariance, gains = np.diag(self.start_std**2), [np.zeros_like(self.C.T)]
        for _ in range(MOST_GAINS):
            gain, _, covariance = self._update(covariance)
            gains.append(gain)
            if np.abs(gains[-1] - gains[-2]).max() <= _SETTLED * np.abs(gain).max():
                break
            covariance = self._expect(covariance)
        return np.array(gains[1:])

    def filter(self, measured: Float[np.ndarray, "T Y"]) -> Filtered:
        """Filter a recording: the state at each step, given the measurements up to it."""
        mean, covariance = self.start_mean, np.diag(self.start_std**2)
        steps, log_likelihood = [], 0.0
        for y in measured:
            gain, spread, updated = self._update(covariance)
            surprise = y - self.C @ mean
            log_likelihood -= 0.5 * (
                np.linalg.slogdet(2 * np.pi * spread)[1]
                + surprise @ np.linalg.solve(spread, surprise)
            )
            corrected = mean + gain @ surprise
            steps.append((mean, covariance, corrected, updated))
            mean, covariance = self.A @ corrected, self._expect(updated)
        expected, expected_covariance, means, covariances = map(np.array, zip(*steps, strict=True))
        return Filtered(expected, expected_covariance, means, covariances, log_likelihood)

    def _update(
        self, covariance: Float[np.ndarray, "X X"]
    ) -> tuple[Float[np.ndarray, "X Y"], Float[np.ndarray, "Y Y"], Float[np.ndarray, "X X"]]:
        return corrected(covariance, self.C, self.noise_std)

    def _expect(self, covariance: Float[np.ndarray, "X X"]) -> Float[np.ndarray, "X X"]:
        """Covariance one step later."""
        return self.A @ covariance @ self.A.T + self._process_noise

    @functools.cached_property
    def _process_noise(self) -> Float[np.ndarray, "X X"]:
        return np.tensordot(self.change_std**2, self.shape, 1)


def corrected(
    covariance: Float[np.ndarray, "X X"],
    C: Float[np.ndarray, "Y X"],
    noise_std: Float[np.ndarray, " Y"],
) -> tuple[Float[np.ndarray, "X Y"], Float[np.ndarray, "Y Y"], Float[np.ndarray, "X X"]]:
    """Gain, covariance of the measurement, and covariance of the state after it."""
    noise = np.diag(noise_std**2)
    spread = C @ covariance @ C.T + noise
    gain = np.linalg.solve(spread, C @ covariance).T
    rest = np.eye(len(covariance)) - gain @ C
    # Joseph's form: stays symmetric and positive, however exact the measurement
    return gain, spread, rest @ covariance @ rest.T + gain @ noise @ gain.T


def fit_motion(
    task: TaskSpec,
    measured: Float[np.ndarray, "T Y"],
    noise_std: Float[np.ndarray, " Y"] | None = None,
) -> Motion:
    """The motion under which a recording is most likely.

    One episode was measured, in the units of the measured states; the noise of each measurement, in
    its unit, is estimated where it is not known.

    Raises:
        InputError: the recording has fewer than three measurements, or than two where their noise
            is known.
    """
    fewest = 3 if noise_std is None else 2
    if len(measured) < fewest:
        raise InputError(
            f"A motion is fitted to at least {fewest} measurements, got {len(measured)}; "
            "record a longer episode, or let it end later."
        )
    spread = np.maximum(measured.std(0), 1e-9)
    changes = _rough_changes(task, measured)
    begin, bounds = np.log(changes), [(np.log(c) - 7.0, np.log(c) + 7.0) for c in changes]
    if noise_std is None:
        begin = np.concatenate([begin, np.log(0.01 * spread)])
        bounds += [(np.log(_SMALLEST_NOISE * s), np.log(s)) for s in spread]

    def motion(logarithms: Float[np.ndarray, " n"]) -> Motion:
        stds = np.exp(logarithms)
        known = stds[len(changes) :] if noise_std is None else noise_std
        return Motion.of(task, stds[: len(changes)], known)

    found = minimize(
        lambda logarithms: -motion(logarithms).filter(measured).log_likelihood,
        begin,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": 50},
    )
    return motion(found.x)


def smooth(motion: Motion, measured: Float[np.ndarray, "T Y"]) -> Float[np.ndarray, "T X"]:
    """The mean of each state given all measurements: without delay, so for recordings only.

    Reference: Rauch, Tung, Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA
    Journal 3 (8), 1965.
    """
    known = motion.filter(measured)
    states = known.means.copy()
    for t in reversed(range(len(states) - 1)):
        # G = P A^T P'^-1 with P of this step after its measurement, P' of the next before its own
        ahead = np.linalg.solve(known.expected_covariance[t + 1], motion.A @ known.covariances[t])
        states[t] += ahead.T @ (states[t + 1] - known.expected[t + 1])
    return states


def _rough_changes(task: TaskSpec, measured: Float[np.ndarray, "T Y"]) -> Float[np.ndarray, " E"]:
    """Spread of the change in one step of each state that is no position, by differences."""
    column = {state: measured[:, k] for k, state in enumerate(task.measured_states)}
    position = {velocity: q for q, velocity in task.velocities}
    rough = []
    for state in speed_integration(task).predicted:
        if state in column:
            changes = np.diff(column[state])
        else:
            speeds = np.diff(column[position[state]]) / task.dt
            # of a single step, the change from how episodes start
            changes = np.diff(speeds) if len(speeds) > 1 else speeds - task.start_mean[state]
        rough.append(np.sqrt((changes**2).mean()) + 1e-6)
    return np.array(rough)
