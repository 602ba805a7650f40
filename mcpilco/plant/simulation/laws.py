"""Forces in a joint, for compiled callers: one formula a law."""

from __future__ import annotations

import math

from numba import njit

from mcpilco.bodies import INLINED

VISCOUS, COULOMB, STRIBECK, QUADRATIC, ASYMMETRIC, SPRING, HARDENING, CONSTANT, RIPPLE = range(9)
"""effects of `mcpilco.plant.effects.joint`; their symbols, in order, are the constants a to d"""


@njit(**INLINED)
def turn_over(law, a, b, c, d):
    """Velocity over which a law's dry friction turns over [m/s or rad/s]; 0 if there is none."""
    if law == COULOMB and a != 0.0:
        return b
    if law == STRIBECK and (a != 0.0 or b != 0.0):
        return d
    if law == ASYMMETRIC and (a != 0.0 or b != 0.0):
        return c
    return 0.0


@njit(**INLINED)
def joint_force(law, q, v, a, b, c, d):
    """Force of a law on its joint [N or N m], at position q and velocity v."""
    if law == VISCOUS:
        return -a * v
    if law == COULOMB:
        return -a * math.tanh(v / b)
    if law == STRIBECK:
        return -(a + b * math.exp(-((v / c) ** 2))) * math.tanh(v / d)
    if law == QUADRATIC:
        return -a * v * abs(v)
    if law == ASYMMETRIC:
        sign = math.tanh(v / c)
        return -0.5 * ((a + b) * sign + (a - b) * abs(sign))
    if law == SPRING:
        return -a * q
    if law == HARDENING:
        return -a * q * q * q
    if law == CONSTANT:
        return a
    return a * math.sin(c * q) + b * math.cos(c * q)
