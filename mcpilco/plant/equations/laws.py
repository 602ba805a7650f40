"""Forces in joints and at actuators, for numbers of any kind; the formulas are the effects'."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from mcpilco.plant.equations.number import Real, cos, exp, larger, sin, smaller, tanh
from mcpilco.plant.simulation import laws
from mcpilco.plant.simulation.tables import DEAD_ZONE, GAIN, LIMIT, RANGE


def _asymmetric(q: Real, v: Real, a: Real, b: Real, c: Real, d: Real) -> Real:
    sign = tanh(v / c)
    return -0.5 * ((a + b) * sign + (a - b) * abs(sign))


JOINT_LAWS: dict[int, Callable[..., Real]] = {
    laws.VISCOUS: lambda q, v, a, b, c, d: -a * v,
    laws.COULOMB: lambda q, v, a, b, c, d: -a * tanh(v / b),
    laws.STRIBECK: lambda q, v, a, b, c, d: -(a + b * exp(-1.0 * (v / c) * (v / c))) * tanh(v / d),
    laws.QUADRATIC: lambda q, v, a, b, c, d: -a * v * abs(v),
    laws.ASYMMETRIC: _asymmetric,
    laws.SPRING: lambda q, v, a, b, c, d: -a * q,
    laws.HARDENING: lambda q, v, a, b, c, d: -a * q * q * q,
    laws.CONSTANT: lambda q, v, a, b, c, d: a,
    laws.RIPPLE: lambda q, v, a, b, c, d: a * sin(c * q) + b * cos(c * q),
}
"""force on a joint [N or N m] at position q and velocity v, see `mcpilco.plant.simulation.laws`"""


def shaped(actuator: Sequence[Any], command: Real) -> Real:
    """The force that a command asks for: behind range, gain, dead zone and limit.

    Args:
        actuator: a row of `mcpilco.plant.simulation.Tables.actuators`.
        command: in its unit.
    """
    x = limited(command, actuator[RANGE]) * actuator[GAIN]
    dead = actuator[DEAD_ZONE]
    if dead != 0.0:
        x = larger(x - dead, 0.0) + smaller(x + dead, 0.0)
    return limited(x, actuator[LIMIT])


def limited(x: Real, most: float) -> Real:
    """x within +-most."""
    return x if most == math.inf else smaller(larger(x, -most), most)
