"""What systems look like alike: colours, a picture's size, how a pole is turned, a torque."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from jaxtyping import Float

from envs.drawing import Canvas, Point

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


def twist(canvas: Canvas, hinge: Point, push: float, radius: float) -> None:
    """Draws a torque as an arc with an arrow: from below to positive x where it is positive.

    Args:
        canvas: what is drawn on.
        hinge: around which.
        push: torque, relative to its limit, in [-1, 1]; 0 draws nothing.
        radius: of the arc.
    """
    if not push:
        return
    angles = np.linspace(0.0, 0.75 * np.pi * push, 13)
    x, z = hinge[0] + radius * np.sin(angles), hinge[1] - radius * np.cos(angles)
    *arc, (start, end) = pairwise(zip(x.tolist(), z.tolist(), strict=True))
    for piece in arc:
        canvas.line(*piece, 0.02, INPUT_COLOR)
    canvas.arrow(start, end, 0.02, INPUT_COLOR)
