"""The boards' double pendulum, compiled for one state at a time, in their order of states.

Their simulator and our observer ask for it thousands of times a second of motion.
"""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from numba import njit

from mcpilco.plant import Plant

DT = 0.002
"""time between two calls of a controller [s]"""
JOINT = {"pendubot": 0, "acrobot": 1}
"""which joint has the motor"""
Row = Float[np.ndarray, " P"]
"""numbers of a plant: (m1 r1, m2 r2, m2, l1, I1, I2, gravity, b1, b2, cf1, cf2, Ir, gear ratio)"""
ENDS = "upper", "lower"
"""links"""
State = Float[np.ndarray, " 4"]
"""shoulder and elbow angle, their velocities [rad, rad/s]"""


def nominal_row(plant: Plant) -> Row:
    """The numbers of one of our double pendulums, without friction and rotors."""
    p = plant.values
    m1, m2, l1, l2 = (p[f"{end}_{what}"] for what in ("mass", "length") for end in ENDS)
    r1, r2 = p["upper_center"] * l1, p["lower_center"] * l2
    I1, I2 = p["upper_inertia"] * m1 * l1**2, p["lower_inertia"] * m2 * l2**2
    about_joints = I1 + m1 * r1**2, I2 + m2 * r2**2
    return np.array([m1 * r1, m2 * r2, m2, l1, *about_joints, p["gravity"], *[0.0] * 6])


@njit(cache=True)
def slope(x: State, u1: float, u2: float, p: Row) -> State:
    """Velocities and accelerations under torques u1, u2 [N m]: M(q) q'' = forces."""
    m1r1, m2r2, m2, l1, I1, I2, gravity, b1, b2, cf1, cf2, Ir, gear = p
    q1, q2, v1, v2 = x
    h, rotor = l1 * m2r2, gear * gear * Ir
    M11 = I1 + I2 + m2 * l1 * l1 + 2.0 * h * math.cos(q2) + rotor + Ir
    M12 = I2 + h * math.cos(q2) - gear * Ir
    M22 = I2 + rotor
    s = h * math.sin(q2)
    g2 = m2r2 * gravity * math.sin(q1 + q2)
    g1 = (m1r1 + m2 * l1) * gravity * math.sin(q1) + g2
    f1 = u1 + s * (2.0 * v1 + v2) * v2 - g1 - b1 * v1 - cf1 * math.atan(100.0 * v1)
    f2 = u2 - s * v1 * v1 - g2 - b2 * v2 - cf2 * math.atan(100.0 * v2)
    det = M11 * M22 - M12 * M12
    return np.array([v1, v2, (M22 * f1 - M12 * f2) / det, (M11 * f2 - M12 * f1) / det])


@njit(cache=True)
def step(x: State, u1: float, u2: float, p: Row, dt: float) -> State:
    """The state dt [s] later, by one step of Runge and Kutta of fourth order."""
    a = slope(x, u1, u2, p)
    b = slope(x + 0.5 * dt * a, u1, u2, p)
    c = slope(x + 0.5 * dt * b, u1, u2, p)
    d = slope(x + dt * c, u1, u2, p)
    return x + dt / 6.0 * (a + 2.0 * (b + c) + d)
