"""Forces in a joint that depend on what was before: each has a memory of two numbers.

Beside its formula, `force`, such an effect gives what its memory is at a start, `begin`, and what
becomes of it on a short way, `follow`. Whatever simulates it keeps the memory from step to step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np

from mcpilco.bodies import where
from mcpilco.plant.arithmetic import cos, exp, larger, sin, smaller, sqrt
from mcpilco.plant.effects.base import Effect, Probe, Scale, Symbol
from mcpilco.plant.effects.joint import SMALL, JointForce

Memory = tuple[Any, Any]
TURNING = 20.0
"""ways x_d in a second of the speed at which a step must end that passes over rest [1/s]"""
FREE, BRIEF = 0.2, 1e-3
"""longest part of a spring's motion over which it may touch or let go [rad], and the part of it
that may pass over that [-]"""


class Moment(NamedTuple):
    """A joint at one time."""

    q: Any
    """position [m or rad]"""
    v: Any
    """velocity [m/s or rad/s]"""
    a: Any
    """acceleration [m/s^2 or rad/s^2]; not known at the end of a way"""
    F: Any
    """what its actuators give [N or N m]"""


class RememberingForce(JointForce):
    """A force of a joint's motion and of a memory (x, y)."""

    decides: ClassVar[bool] = True
    """whether its formulas hold an `if`; without one they take packs (`mcpilco.bodies.packs`)"""

    @staticmethod
    def force(q: Any, v: Any, *more: Any) -> Any:
        """The force on the joint [N or N m], of q, v, F if it is `loaded`, x, y, and its values."""
        raise NotImplementedError

    @staticmethod
    def begin(now: Moment, *parameters: Any) -> Memory:
        """The memory at the start of a motion of which nothing is known before."""
        raise NotImplementedError

    @staticmethod
    def follow(memory: Memory, since: Any, before: Moment, now: Moment, *parameters: Any) -> Memory:
        """The memory `since` seconds, not 0, after it was as given: a step, or a part of one."""
        raise NotImplementedError

    def in_equations(self) -> bool:
        return False  # a state of the model would have to hold the memory

    write_mjcf = Effect.write_mjcf


class DahlFriction(RememberingForce):
    """-f_c z with x_d z' = v - |v| z: dry friction that turns over, like a spring, on the way x_d.

    The joint gives way before it slides: presliding, or a cable that is bent back and forth. If x_d
    is small this is Coulomb friction. While the direction stays, z is an exponential of the way.

    Reference: Dahl, A solid friction model, Aerospace Corporation TOR-0158 (1968).
    """

    name = "dahl_friction"
    special = ("coulomb_friction",)
    repeats = ("coulomb_friction", "stribeck_friction", "asymmetric_friction")
    decides = False
    symbols = (
        Symbol("f_c", "{f}", low=0.0),
        Symbol("x_d", "{q}", 1e-2, 1e-6, within=("way", 1e-3, 2.0)),
    )

    @staticmethod
    def force(q, v, x, y, f_c, x_d):
        return -f_c * x

    @staticmethod
    def begin(now, f_c, x_d):
        sign = where(now.v > 0.0, 1.0, -1.0)
        # it slid until it turned round, and speeds up since then
        way = 0.5 * now.v * now.v / larger(sign * now.a, 1e-9)
        return where(now.v == 0.0, 0.0, sign * (1.0 - 2.0 * exp(-way / x_d))), 0.0

    @staticmethod
    def follow(memory, since, before, now, f_c, x_d):
        way, turns = now.q - before.q, before.v * now.v < 0.0
        # where it turns round its velocity is a straight line
        braked = where(turns, before.v - now.v, 1.0)
        there = where(turns, 0.5 * since * before.v * before.v / braked, way)
        z = memory[0]
        for part in (there, way - there):
            sign = where(part > 0.0, 1.0, -1.0)
            z = sign + (z - sign) * exp(-abs(part) / x_d)
        return z, 0.0

    def turn_over(self, values: Sequence[float]) -> float:
        return TURNING * values[1] if values[0] != 0.0 else 0.0

    def probes(self, scale: Scale) -> list[Probe]:
        ways = [part * scale.way for part in (0.01, 0.1, 0.5)]
        return [Probe(np.array([[SMALL * scale.force, way]])) for way in ways]


class BackEMF(RememberingForce):
    """-b v behind the lag T of the current, T F' = u - b v - F: a motor driven by a voltage.

    Of a motor with the constant k, the resistance R and the inductance L, b is k^2 / R and T is
    L / R. Where T is 0 this is viscous friction, where b is 0 it is a lag of the actuator, and R is
    a gain: recordings cannot tell them.
    """

    name = "back_emf"
    loaded = True
    special = ("viscous_friction", "actuator_lag")
    repeats = ("viscous_friction", "asymmetric_viscous_friction")
    symbols = (Symbol("b", "{f} s/{q}", low=0.0), Symbol("T", "s", low=0.0, high=0.2))

    @staticmethod
    def force(q, v, F, x, y, b, T):
        return x - F if T > 0.0 else -b * v

    @staticmethod
    def begin(now, b, T):
        return now.F - b * now.v, 0.0

    @staticmethod
    def follow(memory, since, before, now, b, T):
        if T <= 0.0:
            return memory
        # towards g + g1 t + g2 t^2, the velocity a parabola
        g, g2 = before.F - b * before.v, b * (before.a - (now.v - before.v) / since) / since
        g1 = (now.F - before.F) / since - b * before.a
        first = g - T * (g1 - 2.0 * T * g2)
        last = first + since * (g1 - 2.0 * T * g2 + since * g2)
        return last + (memory[0] - first) * exp(-since / T), 0.0

    def made_of(self, parts: Mapping[str, Sequence[float]]) -> list[float] | None:
        """Values with which it does about what a viscous friction and a lag do together."""
        if parts.keys() != {"viscous_friction", "actuator_lag"}:
            return None
        return [*parts["viscous_friction"], *parts["actuator_lag"]]

    def probes(self, scale: Scale) -> list[Probe]:
        small = SMALL * scale.force / scale.velocity
        return [Probe(np.array([[small, lag]]), proportional=False) for lag in (0.004, 0.03)]


class ElasticJoint(RememberingForce):
    """A motor of inertia I_m drives the joint by a spring k, which is damped by the ratio z.

    The joint's encoder is behind the spring, its memory the motor's angle and velocity less those
    of the joint. Where k is large this is an armature.
    """

    name = "elastic_joint"
    loaded = True
    special: ClassVar[tuple[str, ...]] = ("armature",)
    repeats: ClassVar[tuple[str, ...]] = ("armature",)
    symbols: ClassVar[tuple[Symbol, ...]] = (
        Symbol("I_m", "{f} s^2/{q}", low=0.0),
        Symbol("k", "{f}/{q}", np.inf, 1e-6, within=("stiffness", 1e-6, 1.0)),
        Symbol("z", "-", 0.1, 0.01, 0.9),
    )

    @staticmethod
    def force(q, v, F, x, y, I_m, k, z, g=0.0):
        if I_m == 0.0:
            return 0.0
        pressed = x - larger(smaller(x, g), -g)
        return k * pressed + (2.0 * z * sqrt(k * I_m) * y if abs(x) >= g else 0.0) - F

    @staticmethod
    def begin(now, I_m, k, z, g=0.0):
        pressing = now.F - I_m * now.a
        return pressing / k + (g if pressing > 0.0 else -g), 0.0

    @staticmethod
    def follow(memory, since, before, now, I_m, k, z, g=0.0):
        if I_m == 0.0:
            return memory
        x, y = memory
        # x'' + 2 z w x' + w^2 x = r + r1 t, the joint's velocity a parabola
        w = sqrt(k / I_m)
        d, f = z * w, w * sqrt(1.0 - z * z)
        r = before.F / I_m - before.a
        more = (now.F - before.F) / I_m - 2.0 * ((now.v - before.v) / since - before.a)
        r1 = more / since
        left, most, brief = since, since, FREE / w if g > 0.0 else since
        while left > 0.0:
            touches, side = abs(x) >= g, 1.0 if x > 0.0 else -1.0
            if touches:  # and does not let go while it is bent by more than it swings
                slope = r1 / (w * w)
                bent = (r - 2.0 * d * slope) / (w * w)
                e, u = x - side * g - bent, y - slope
                swings, still = sqrt(e * e + (u + d * e) ** 2 / (f * f)), bent + slope * left
                stays = left if smaller(side * bent, side * still) > swings else 0.0
            else:  # and reaches an edge, at the fastest, after the time `stays`
                fastest = abs(y) + left * (0.5 * abs(r) + left * abs(r1) / 6.0)
                stays = (g - abs(x)) / fastest if fastest > 0.0 else left
            t = smaller(most, larger(brief, stays))
            if touches:
                c, s = exp(-d * t) * cos(f * t), exp(-d * t) * sin(f * t) / f
                ahead = e * c + (u + d * e) * s + side * g + bent + slope * t
                y1 = u * c - (w * w * e + d * u) * s + slope
            else:
                ahead, y1 = x + t * (y + t * (0.5 * r + r1 * t / 6.0)), y + t * (r + 0.5 * r1 * t)
            if touches == (abs(ahead) < g) and t > BRIEF * brief:
                edge = g if x + ahead > 0.0 else -g
                most = t * larger(0.99 * (edge - x) / (ahead - x), 0.1)
                continue
            x, y, r, left = ahead, y1, r + r1 * t, left - t
            most = left
        return x, y

    def probes(self, scale: Scale) -> list[Probe]:
        rotor, k = SMALL * scale.inertia, SMALL * scale.stiffness
        return [Probe(np.array([[rotor, part * k, 0.1]])) for part in (0.004, 0.04, 0.4)]

    def write_mjcf(self, *_: Any) -> str:
        return "give the motor a hinge of its own, and couple it to the joint by a fixed tendon."


class JointBacklash(ElasticJoint):
    """A motor of inertia I_m drives the joint by a spring k that does not touch it within g.

    The play of a gear is 2 g. The spring is damped by the ratio z.
    """

    name = "joint_backlash"
    special = ("elastic_joint",)
    repeats = ("armature", "elastic_joint")
    symbols = (*ElasticJoint.symbols, Symbol("g", "{q}", low=0.0, within=("position", 0.0, 2.0)))

    def probes(self, scale: Scale) -> list[Probe]:
        springs = [probe.values[0] for probe in super().probes(scale)[1:]]
        gaps = [part * scale.way for part in (0.03, 0.15)]
        return [
            Probe(np.array([[*spring, gap]]), proportional=False)
            for spring in springs
            for gap in gaps
        ]
