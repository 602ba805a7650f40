"""A recording as the regression of the torques takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_filter

from mcpilco.recordings import Recording

SMOOTHED, ORDER = 31, 3
"""samples of the windows of the polynomials that give velocity and acceleration, and their order"""
FILTERED = 61
"""samples of the windows that measured torques and regressors go through, both alike"""
KEPT = 5
"""every so many samples are used: neighbours say the same"""


@dataclass(frozen=True)
class Motion:
    """A recording as the regression takes it: N samples of both joints."""

    recording: Recording
    q: Float[np.ndarray, "N 2"]
    dq: Float[np.ndarray, "N 2"]
    ddq: Float[np.ndarray, "N 2"]
    tau: Float[np.ndarray, "N 2"]
    """measured [N m]"""

    @classmethod
    def of(cls, recording: Recording) -> Motion:
        """All samples but those at the ends."""
        inside = slice(SMOOTHED // 2, len(recording) - SMOOTHED // 2)

        def smooth(x: np.ndarray, order: int) -> np.ndarray:
            found = savgol_filter(x, SMOOTHED, ORDER, deriv=order, delta=recording.dt, axis=0)
            return found[inside]

        q, dq, ddq = (smooth(recording.states[:, 0::2], order) for order in range(3))
        return cls(recording, q, dq, ddq, recording.inputs[inside])


def low_passed(x: Float[np.ndarray, "N ..."]) -> Float[np.ndarray, "M ..."]:
    """A signal without its quick changes, every `KEPT`th sample, none from near the ends.

    Torques and regressor go through it alike: what it takes from one it takes from the other.
    """
    half = FILTERED // 2
    return savgol_filter(x, FILTERED, ORDER, axis=0)[half:-half:KEPT]
