"""What a pendulum looks like: a scene of shapes in 3D, and a picture."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, UInt8

from envs.drawing import Canvas
from envs.look import (
    BACKGROUND,
    FIXED_COLOR,
    HEIGHT,
    POLE_COLOR,
    POLE_RADIUS,
    TARGET_COLOR,
    WIDTH,
    hanging,
    twist,
)
from envs.pendulum_dynamics import PendulumDynamics
from mcpilco.show.scene import Pose, Scene, Shape

# sizes in lengths of the pendulum [-], so that one of any size looks the same
MASS_RADIUS = 0.11
MOTOR_HALF = (0.1, 0.14, 0.1)
ARC_RADIUS = 0.3

VIEW_WIDTH = 4.4
"""what a picture shows from left to right, in lengths of the pendulum [-]"""


def scene(dynamics: PendulumDynamics) -> Scene:
    """The pendulum in 3D: in the x-z plane, the hinge at the origin; the marker is the mass."""
    length = dynamics.length

    def poses(states: Float[np.ndarray, "T 2"]) -> Mapping[str, Pose]:
        tip, turned = dynamics.tip(states), hanging(states[:, 0])
        return {"rod": Pose(0.5 * tip, turned), "mass": Pose(tip, turned)}

    shapes = {
        "rod": Shape("capsule", (POLE_RADIUS * length, 0.5 * length), FIXED_COLOR),
        "mass": Shape("sphere", (MASS_RADIUS * length,), POLE_COLOR),
    }
    motor = Shape("box", tuple(length * half for half in MOTOR_HALF), FIXED_COLOR)
    return Scene(
        shapes=shapes,
        poses=poses,
        marker=dynamics.tip,
        fixed=((motor, (0.0, 0.0, 0.0)),),
        target=(0.0, 0.0, length),
    )


def picture(
    dynamics: PendulumDynamics, state: Float[np.ndarray, " 2"], push: float = 0.0
) -> UInt8[np.ndarray, "H W 3"]:
    """The pendulum from the side, with the target of its mass and the torque.

    Args:
        dynamics: says how long the pendulum is.
        state: [q, q'] [rad, rad/s].
        push: torque, relative to its limit, in [-1, 1].
    """
    x, _, z = (dynamics.tip(state) / dynamics.length).tolist()
    # the picture's unit is the length of the pendulum
    canvas = Canvas(WIDTH, HEIGHT, VIEW_WIDTH, (0.0, 0.0), BACKGROUND)
    canvas.box((0.0, 0.0), MOTOR_HALF[::2], 0.04, FIXED_COLOR)
    canvas.ring((0.0, 1.0), 0.08, 0.02, TARGET_COLOR)
    canvas.line((0.0, 0.0), (x, z), POLE_RADIUS, FIXED_COLOR)
    canvas.disc((x, z), MASS_RADIUS, POLE_COLOR)
    canvas.disc((0.0, 0.0), 0.5 * POLE_RADIUS, BACKGROUND)
    twist(canvas, (0.0, 0.0), push, ARC_RADIUS)
    return canvas.image()
