"""States of a whole recording, from the measurements before and after each of them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from mcpilco.sensing.motion import Motion


def smooth(motion: Motion, measured: Float[np.ndarray, "T Y"]) -> Float[np.ndarray, "T X"]:
    """The mean of each state given all measurements: without delay, so for recordings only.

    Args:
        motion: how the state moves, and how it is measured.
        measured: of each step, in the unit of the measured states.

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
