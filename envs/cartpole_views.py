"""What a cart-pole looks like: a scene of shapes in 3D, and a picture."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, UInt8

from envs.cartpole_dynamics import CartPoleDynamics
from envs.drawing import Canvas
from envs.look import (
    BACKGROUND,
    FIXED_COLOR,
    HEIGHT,
    INPUT_COLOR,
    POLE_COLOR,
    POLE_RADIUS,
    TARGET_COLOR,
    WIDTH,
    hanging,
    upright,
)
from mcpilco.show.scene import Pose, Scene, Shape

CART_COLOR = (64, 84, 120)

# sizes in pole lengths [-], so that a cart-pole of any size looks the same
CART_HALF = (0.24, 0.14, 0.11)
RAIL_HALF = (6.0, 0.03, 0.02)

VIEW_WIDTH = 5.4
"""what a picture shows from left to right, in pole lengths [-]"""
VIEW_MARGIN = 1.6
"""how far from the middle the cart may be before the view follows it, in pole lengths [-]"""


def scene(dynamics: CartPoleDynamics) -> Scene:
    """The cart-pole in 3D: in the x-z plane, the hinge at z = 0; the marker is the pole's tip."""
    length = dynamics.pole_length

    def poses(states: Float[np.ndarray, "T 4"]) -> Mapping[str, Pose]:
        hinge = np.zeros((len(states), 3))
        hinge[:, 0] = states[:, 0]
        return {
            "cart": Pose(hinge, upright(len(states))),
            "pole": Pose(0.5 * (hinge + dynamics.tip(states)), hanging(states[:, 2])),
        }

    shapes = {
        "cart": Shape("box", tuple(length * half for half in CART_HALF), CART_COLOR),
        "pole": Shape("capsule", (POLE_RADIUS * length, 0.5 * length), POLE_COLOR),
    }
    rail = Shape("box", tuple(length * half for half in RAIL_HALF), FIXED_COLOR)
    return Scene(
        shapes=shapes,
        poses=poses,
        marker=dynamics.tip,
        fixed=((rail, (0.0, 0.0, 0.0)),),
        target=(0.0, 0.0, length),
    )


def picture(
    dynamics: CartPoleDynamics, state: Float[np.ndarray, " 4"], push: float = 0.0
) -> UInt8[np.ndarray, "H W 3"]:
    """The cart-pole from the side, with its rail, the target of the tip and the force.

    Args:
        dynamics: says how long the pole is.
        state: [q1, q1', q2, q2'] [m, m/s, rad, rad/s].
        push: force on the cart, relative to its limit, in [-1, 1].
    """
    length = dynamics.pole_length
    cart = float(state[0]) / length
    tip_x, _, tip_z = (dynamics.tip(state) / length).tolist()
    middle = cart - min(max(cart, -VIEW_MARGIN), VIEW_MARGIN)
    left, right = middle - VIEW_WIDTH, middle + VIEW_WIDTH

    # the picture's unit is the length of the pole
    canvas = Canvas(WIDTH, HEIGHT, VIEW_WIDTH, (middle, 0.0), BACKGROUND)
    canvas.line((left, 0.0), (right, 0.0), RAIL_HALF[2], FIXED_COLOR)
    for tick in map(float, range(round(left), round(right) + 1)):
        canvas.line((tick, -0.06), (tick, 0.06), 0.008, FIXED_COLOR)
    canvas.ring((0.0, 1.0), 0.08, 0.02, TARGET_COLOR)
    canvas.disc((0.0, 1.0), 0.02, TARGET_COLOR)
    canvas.box((cart, 0.0), CART_HALF[::2], 0.04, CART_COLOR)
    if push:
        side = cart + math.copysign(CART_HALF[0] + 0.06, push)
        canvas.arrow((side, 0.0), (side + 0.5 * push, 0.0), 0.02, INPUT_COLOR)
    canvas.line((cart, 0.0), (tip_x, tip_z), POLE_RADIUS, POLE_COLOR)
    canvas.disc((cart, 0.0), 0.5 * POLE_RADIUS, BACKGROUND)
    return canvas.image()
