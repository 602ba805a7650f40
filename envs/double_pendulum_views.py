"""What a double pendulum looks like: a scene of shapes in 3D, and a picture."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, UInt8

from envs.double_pendulum_dynamics import DoublePendulumDynamics
from envs.drawing import Canvas, Point
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
from mcpilco.show.scene import Pose, Scene, Shape

# sizes in lengths of both links together [-], so that one of any size looks the same
JOINT_RADIUS = 0.05
TIP_RADIUS = 0.04
MOTOR_HALF = (0.07, 0.1, 0.07)
ARC_RADIUS = 0.2

VIEW_WIDTH = 4.4
"""what a picture shows from left to right, in lengths of both links together [-]"""


def scene(dynamics: DoublePendulumDynamics) -> Scene:
    """The links in 3D: in the x-z plane, the shoulder at the origin; the marker is the tip."""
    reach, radius = dynamics.reach, POLE_RADIUS * dynamics.reach

    def poses(states: Float[np.ndarray, "T 4"]) -> Mapping[str, Pose]:
        elbow, tip = dynamics.elbow(states), dynamics.tip(states)
        upper, lower = hanging(states[:, 0]), hanging(states[:, 0] + states[:, 2])
        return {
            "upper": Pose(0.5 * elbow, upper),
            "lower": Pose(0.5 * (elbow + tip), lower),
            "elbow": Pose(elbow, upper),
            "tip": Pose(tip, lower),
        }

    shapes = {
        "upper": Shape("capsule", (radius, 0.5 * dynamics.upper_length), FIXED_COLOR),
        "lower": Shape("capsule", (radius, 0.5 * dynamics.lower_length), POLE_COLOR),
        "elbow": Shape("sphere", (JOINT_RADIUS * reach,), FIXED_COLOR),
        "tip": Shape("sphere", (TIP_RADIUS * reach,), POLE_COLOR),
    }
    base = Shape("box", tuple(reach * half for half in MOTOR_HALF), FIXED_COLOR)
    return Scene(
        shapes=shapes,
        poses=poses,
        marker=dynamics.tip,
        fixed=((base, (0.0, 0.0, 0.0)),),
        target=(0.0, 0.0, reach),
    )


def picture(
    dynamics: DoublePendulumDynamics, state: Float[np.ndarray, " 4"], push: float = 0.0
) -> UInt8[np.ndarray, "H W 3"]:
    """The links from the side, with the target of their tip and the torque at its joint.

    Args:
        dynamics: says how long the links are, and where the motor is.
        state: [q1, q1', q2, q2'] [rad, rad/s].
        push: torque, relative to its limit, in [-1, 1].
    """
    shoulder = (0.0, 0.0)
    # the picture's unit is the length of both links together
    elbow, tip = (
        _seen(point / dynamics.reach) for point in (dynamics.elbow(state), dynamics.tip(state))
    )
    canvas = Canvas(WIDTH, HEIGHT, VIEW_WIDTH, shoulder, BACKGROUND)
    canvas.box(shoulder, MOTOR_HALF[::2], 0.03, FIXED_COLOR)
    canvas.ring((0.0, 1.0), 0.08, 0.02, TARGET_COLOR)
    canvas.line(shoulder, elbow, POLE_RADIUS, FIXED_COLOR)
    canvas.line(elbow, tip, POLE_RADIUS, POLE_COLOR)
    canvas.disc(elbow, JOINT_RADIUS, FIXED_COLOR)
    canvas.disc(tip, TIP_RADIUS, POLE_COLOR)
    for joint in (shoulder, elbow):
        canvas.disc(joint, 0.5 * POLE_RADIUS, BACKGROUND)
    twist(canvas, (shoulder, elbow)[dynamics.motor], push, ARC_RADIUS)
    return canvas.image()


def _seen(point: Float[np.ndarray, " 3"]) -> Point:
    """x and z."""
    return float(point[0]), float(point[2])
