"""Filtered positions, velocities, accelerations and forces of all joints of a robot.

Encoders are noisy, and derivatives magnify their noise with the frequency. Two filters:

- `zero_phase`: a Butterworth filter run forward and backward over positions and forces alike, so
  that nothing is delayed; then central differences, and fewer rows. `motion_cutoff` finds a cutoff
  for it.
- `local_cubics`: derivatives of a cubic fitted around each sample, forces as they were measured.

Reference: Janot, Vandanjon, Gautier, A generic instrumental variable approach for industrial robot
    identification, IEEE Transactions on Control Systems Technology 22 (1), 2014, section II;
    Savitzky, Golay, Smoothing and differentiation of data by simplified least squares procedures,
    Analytical Chemistry 36 (8), 1964.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import butter, savgol_filter, sosfiltfilt, welch

from mcpilco.config import TURN_OVER
from mcpilco.plant import CoulombFriction
from mcpilco.recordings.recording import Samples
from mcpilco.typing import InputError

ByJoint = Float[np.ndarray, "T J"]
"""on a uniform grid of step dt [s]: positions q [rad or m], velocities dq [rad/s or m/s], of which
columns of NaN are derived from the positions, or forces tau [N m or N]"""

ORDER = 4
"""of the Butterworth filter, each way"""
ROWS_A_PERIOD = 8.0
"""rows that are kept in a period of the cutoff"""
LEFT_OUT = 3.0
"""periods of the cutoff at both ends, where a filter has nothing to go by"""
WINDOW = 15
"""samples of a local cubic"""
ABOVE_NOISE = 5.0
"""spectrum, relative to that of the noise, from which on there is motion [-]"""
MOVED = 0.99
"""share of the positions' variance that is within the motion's bandwidth [-]"""
MARGIN = 4.0
"""the cutoff, relative to that bandwidth [-]"""
_SECONDS = 4.0  # of the windows of a spectrum


@dataclass(frozen=True)
class JointMotion(Samples):
    """N rows of J joints; nothing is masked."""

    q: Float[np.ndarray, "N J"]
    """positions [rad or m]"""
    dq: Float[np.ndarray, "N J"]
    """velocities [rad/s or m/s]"""
    ddq: Float[np.ndarray, "N J"]
    """accelerations [rad/s^2 or m/s^2]"""
    tau: Float[np.ndarray, "N J"]
    """forces [N m or N]"""
    dry: Float[np.ndarray, "N J"]
    """what dry friction of 1 N m or 1 N would be, by the filter of the forces: it jumps, and a
    filtered jump is no jump of filtered velocities"""


def zero_phase(q: ByJoint, dq: ByJoint, tau: ByJoint, dt: float, cutoff: float) -> JointMotion:
    """A motion without what is faster than the cutoff [Hz].

    Raises:
        InputError: the cutoff is beyond half of the sampling rate, or there is too little.
    """
    if not 0.0 < cutoff < 0.5 / dt:
        raise InputError(
            f"cutoff must be between 0 and {0.5 / dt:g} Hz, half of the sampling rate, got "
            f"{cutoff:g}."
        )
    ends = round(LEFT_OUT / (cutoff * dt))
    _require_rows(q, 3 * ends, dt)
    smooth = butter(ORDER, cutoff, fs=1.0 / dt, output="sos")
    q, dq, tau = (sosfiltfilt(smooth, part, axis=0) for part in (q, dq, tau))
    dq = np.where(np.isfinite(dq), dq, np.gradient(q, dt, axis=0))
    ddq = np.gradient(dq, dt, axis=0)
    dry = sosfiltfilt(smooth, _dry(q, dq), axis=0)
    step = max(1, int(1.0 / (ROWS_A_PERIOD * cutoff * dt)))
    return JointMotion(q, dq, ddq, tau, dry)[ends:-ends:step]


def local_cubics(
    q: ByJoint, dq: ByJoint, tau: ByJoint, dt: float, window: int = WINDOW, step: int = 1
) -> JointMotion:
    """A motion by the cubic about each sample.

    Forces are not filtered; there is a row each `step` samples.

    Raises:
        InputError: there is too little.
    """
    _require_rows(q, 2 * window, dt)

    def cubics(values: np.ndarray, derivative: int) -> np.ndarray:
        return savgol_filter(values, window, 3, deriv=derivative, delta=dt, axis=0)

    measured = np.isfinite(dq).all(axis=0)
    known = np.where(measured, dq, 0.0)
    positions = cubics(q, 0)
    speeds = np.where(measured, cubics(known, 0), cubics(q, 1))
    accelerations = np.where(measured, cubics(known, 1), cubics(q, 2))
    dry = _dry(positions, speeds)
    motion = JointMotion(positions, speeds, accelerations, tau, dry)
    return motion[window:-window:step]


def motion_cutoff(q: ByJoint, dt: float) -> float:
    """Four times the bandwidth of the fastest joint's motion [Hz]; a fifth of the rate at most."""
    frequency, power, noise = _spectrum(q, dt)
    motion = np.where(power > ABOVE_NOISE * noise, power - noise, 0.0)
    share = np.cumsum(motion, axis=0)
    within = (share >= MOVED * share[-1]).argmax(axis=0)  # 0 where nothing moves
    return float(np.clip(MARGIN * frequency[within].max(), 2.0 * frequency[1], 0.2 / dt))


def encoder_noise(q: ByJoint, dt: float) -> Float[np.ndarray, " J"]:
    """Standard deviation of each position's noise [rad or m].

    White noise is as strong at all frequencies, and nothing moves at those above a quarter of the
    sampling rate.
    """
    return np.sqrt(_spectrum(q, dt)[2] * 0.5 / dt)


def _dry(q: ByJoint, dq: ByJoint) -> ByJoint:
    """Dry friction of 1 N m or 1 N, as a force that the motor supplies."""
    return CoulombFriction.force(q, dq, -1.0, TURN_OVER)


def _spectrum(
    q: ByJoint, dt: float
) -> tuple[Float[np.ndarray, " F"], Float[np.ndarray, "F J"], Float[np.ndarray, " J"]]:
    """Frequencies [Hz], power a Hz, and its mean in the upper half of them."""
    length = min(len(q), round(_SECONDS / dt))
    frequency, power = welch(q, 1.0 / dt, nperseg=length, detrend="linear", axis=0)
    return frequency, power, power[len(power) // 2 :].mean(axis=0)


def _require_rows(q: ByJoint, least: int, dt: float) -> None:
    if len(q) <= least:
        raise InputError(
            f"more than {least * dt:.3g} s without a gap were expected, got {len(q) * dt:.3g} s; "
            "record for longer."
        )
