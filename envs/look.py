"""What the systems look like alike: colours, the size of a picture, and how a pole is turned."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

POLE_COLOR = (214, 120, 46)
FIXED_COLOR = (150, 156, 166)
TARGET_COLOR = (46, 158, 96)
INPUT_COLOR = (190, 60, 70)
BACKGROUND = (250, 250, 248)

POLE_RADIUS = 0.03
"""of a pole, in its lengths, so that a system of any size looks the same [-]"""
WIDTH, HEIGHT = 640, 352
"""size of a picture [pixel]"""


def upright(count: int) -> Float[np.ndarray, "T 4"]:
    """Quaternions x, y, z, w of a body that is not turned, one for each of `count` states [-]."""
    return np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))


def hanging(angle: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T 4"]:
    """Quaternions x, y, z, w that turn a body's -z axis from hanging to the angle of its pole [-].

    Args:
        angle: 0 hanging, growing as the tip moves to positive x [rad].
    """
    # by -angle about y
    half = -0.5 * angle
    zero = np.zeros_like(half)
    return np.stack([zero, np.sin(half), zero, np.cos(half)], axis=-1)
