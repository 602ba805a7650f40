"""Forces in a joint: friction, springs, and what the motor's magnets do.

To add one: a class here, its line in the catalogue (`mcpilco.plant.effects`), and its row in
`tests/mcpilco/plant/effects/test_catalogue.py`. Whatever runs the formula takes it from the class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from jaxtyping import Float

from mcpilco.config import TURN_OVER
from mcpilco.plant.arithmetic import Tape, cos, exp, larger, sin, smaller, tanh
from mcpilco.plant.effects.base import MOST, Effect, Probe, Scale, Symbol, sizes
from mcpilco.plant.simulation.layout import CONSTANTS, Layout, Tables
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.mjcf import EditedModel

SLOWEST, FASTEST = 5e-4, 0.1
"""velocity over which dry friction may turn over [m/s or rad/s]"""
QUICK = 0.05
"""most of a joint's usual speed within which its dry friction turns over [-]: beyond, it would be
told from viscous friction by its name alone"""
TURN = Symbol("v_r", "{q}/s", TURN_OVER, SLOWEST, FASTEST, False, ("velocity", 0.0, QUICK))
"""dry friction turns over as tanh(v / v_r); every machine has its own v_r"""
SMALL = 0.02
"""of the usual force, that of a probe [-]"""


class JointForce(Effect):
    """A force in a joint, of its position q and velocity v.

    A leaf gives `force`, its formula of numbers of any kind: with + - * /, `abs` and the functions
    of `mcpilco.plant.arithmetic`, and without an `if`. Compiled simulations, programs of a model's
    mean, MJCF files and regressors take it from there.
    """

    place = "joint"
    loaded: ClassVar[bool] = False
    """whether its formula takes the force of the joint's actuators too, behind q and v"""

    @staticmethod
    def force(q: Any, v: Any, *parameters: Any) -> Any:
        """The force on the joint [N or N m].

        It takes position [m or rad], velocity [m/s or rad/s], and a value of each symbol.
        """
        raise NotImplementedError

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.driven if self.loaded else layout.guided

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        if len(values) > CONSTANTS:
            raise InputError(
                f"{self.name} must have at most {CONSTANTS} symbols, got {len(values)}; "
                "divide it into two effects."
            )
        tables.constants[system, at, : len(values)] = values
        tables.turn[system, at] = self.turn_over(values)

    def turn_over(self, values: Sequence[float]) -> float:
        """Velocity over which it turns over [m/s or rad/s]; 0 where it is no dry friction."""
        return 0.0

    def probes(self, scale: Scale) -> list[Probe]:
        """One size that makes a small part of the usual force; for a formula of one symbol."""
        if len(self.symbols) > 1:
            raise NotImplementedError(f"{type(self).__name__} has several symbols: give `probes`.")
        return [sizes(SMALL * scale.force / abs(self.force(scale.position, scale.velocity, 1.0)))]

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        probed = np.concatenate([probe.values for probe in self.probes(scale)])
        usual = np.abs(probed).max(axis=0) / SMALL
        return np.where(self.neutral == 0.0, MOST * usual, np.inf)

    def in_equations(self) -> bool:
        inputs = Tape(2 + len(self.symbols)).inputs
        try:
            self.force(*inputs)
        except TypeError:  # it asks for more than arithmetic of numbers that are not known yet
            return False
        return True

    def write_mjcf(self, model: EditedModel, target: str, values: Sequence[float]) -> str | None:
        if model.add_force(target, lambda q, v: self.force(q, v, *values)):
            return None
        return super().write_mjcf(model, target, values)


class DryFriction(JointForce):
    """A force against the motion that turns over within v_r, as tanh(v / v_r)."""

    @property
    def turn(self) -> int:
        """Which of its values is v_r."""
        return self.symbols.index(TURN)

    @property
    def forces(self) -> tuple[int, ...]:
        """Which of its values are forces: near rest it is at most their sum."""
        return tuple(i for i, symbol in enumerate(self.symbols) if symbol.unit == "{f}")

    def turn_over(self, values: Sequence[float]) -> float:
        return values[self.turn] if any(values[i] != 0.0 for i in self.forces) else 0.0


class ViscousFriction(JointForce):
    """-b v."""

    name = "viscous_friction"
    symbols = (Symbol("b", "{f} s/{q}", low=0.0),)

    @staticmethod
    def force(q, v, b):
        return -b * v


class CoulombFriction(DryFriction):
    """-f_c sign(v), as -f_c tanh(v / v_r)."""

    name = "coulomb_friction"
    symbols = (Symbol("f_c", "{f}", low=0.0), TURN)

    @staticmethod
    def force(q, v, f_c, v_r):
        return -f_c * tanh(v / v_r)

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(SMALL * scale.force, TURN.neutral)]


class SoftFriction(DryFriction):
    """-f_c (v + t v') / v_r, at most f_c either way, as MuJoCo's. Known, as `Servo`.

    It answers to the velocity a time t ahead, as the acceleration v' foretells it: a joint that
    sticks is heavier by f_c t / v_r and damped by f_c / v_r. `force` is what it is where v' is 0.
    """

    name = "soft_friction"
    special = ("coulomb_friction",)
    symbols = (Symbol("f_c", "{f}", low=0.0), TURN, Symbol("t", "s", low=0.0))

    @staticmethod
    def force(q, v, f_c, v_r, t):
        return -f_c * smaller(larger(v / v_r, -1.0), 1.0)


class StribeckFriction(DryFriction):
    """-(f_c + f_d exp(-(v / v_s)^2)) sign(v): dry friction that is f_d stronger at rest."""

    name = "stribeck_friction"
    special = ("coulomb_friction",)
    repeats = ("coulomb_friction", "asymmetric_friction")
    symbols = (
        Symbol("f_c", "{f}", low=0.0),
        Symbol("f_d", "{f}", low=0.0),
        Symbol("v_s", "{q}/s", 0.1, 10.0 * SLOWEST, 1.0),
        TURN,
    )

    @staticmethod
    def force(q, v, f_c, f_d, v_s, v_r):
        return -(f_c + f_d * exp(-1.0 * (v / v_s) * (v / v_s))) * tanh(v / v_r)

    def probes(self, scale: Scale) -> list[Probe]:
        small, turn = SMALL * scale.force, TURN.neutral
        speeds = [min(part * scale.velocity, 1.0) for part in (0.03, 0.1, 0.3)]
        return [Probe(np.array([[small, 0.0, v, turn], [0.0, small, v, turn]])) for v in speeds]


class QuadraticDrag(JointForce):
    """-c v |v|."""

    name = "quadratic_drag"
    symbols = (Symbol("c", "{f} s^2/{q}^2", low=0.0),)

    @staticmethod
    def force(q, v, c):
        return -c * v * abs(v)


class AsymmetricFriction(DryFriction):
    """-f_p where v > 0, +f_n where v < 0: dry friction of another size in each direction."""

    name = "asymmetric_friction"
    special = ("coulomb_friction",)
    repeats = ("coulomb_friction", "constant_force")
    symbols = (Symbol("f_p", "{f}", low=0.0), Symbol("f_n", "{f}", low=0.0), TURN)

    @staticmethod
    def force(q, v, f_p, f_n, v_r):
        sign = tanh(v / v_r)
        return -0.5 * ((f_p + f_n) * sign + (f_p - f_n) * abs(sign))

    def made_of(self, parts: Mapping[str, Sequence[float]]) -> list[float] | None:
        """Values with which it does what a Coulomb friction and a constant force do together."""
        if parts.keys() != {"coulomb_friction", "constant_force"}:
            return None
        (f_c, v_r), (f_0,) = parts["coulomb_friction"], parts["constant_force"]
        return [f_c - f_0, f_c + f_0, v_r]

    def probes(self, scale: Scale) -> list[Probe]:
        small = SMALL * scale.force
        return [Probe(np.array([[small, 0.0, TURN.neutral], [0.0, small, TURN.neutral]]))]


class AsymmetricViscousFriction(JointForce):
    """-b_p v where v > 0, -b_n v where v < 0: viscous friction of another size each way."""

    name = "asymmetric_viscous_friction"
    special = ("viscous_friction",)
    repeats = ("viscous_friction",)
    symbols = (Symbol("b_p", "{f} s/{q}", low=0.0), Symbol("b_n", "{f} s/{q}", low=0.0))

    @staticmethod
    def force(q, v, b_p, b_n):
        return -0.5 * ((b_p + b_n) * v + (b_p - b_n) * abs(v))

    def probes(self, scale: Scale) -> list[Probe]:
        small = SMALL * scale.force / scale.velocity
        return [Probe(np.array([[small, 0.0], [0.0, small]]))]


class LoadDependentFriction(JointForce):
    """-mu |F| sign(v), as -mu |F| tanh(v / v_r), of the force F of the actuators of its joint."""

    name = "load_dependent_friction"
    symbols = (Symbol("mu", "-", low=0.0, high=1.0), TURN)
    loaded = True

    @staticmethod
    def force(q, v, F, mu, v_r):
        return -mu * abs(F) * tanh(v / v_r)

    def turn_over(self, values: Sequence[float]) -> float:
        return values[1] if values[0] != 0.0 else 0.0

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(SMALL, TURN.neutral)]

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        return np.full(2, np.inf)

    def in_equations(self) -> bool:
        return False  # its joint's actuator lags and is late

    write_mjcf = Effect.write_mjcf


class Spring(JointForce):
    """-k q."""

    name = "spring"
    symbols = (Symbol("k", "{f}/{q}", low=0.0),)

    @staticmethod
    def force(q, v, k):
        return -k * q


class HardeningSpring(JointForce):
    """-k_3 q^3."""

    name = "hardening_spring"
    symbols = (Symbol("k_3", "{f}/{q}^3", low=0.0),)

    @staticmethod
    def force(q, v, k_3):
        return -k_3 * q * q * q


class ConstantForce(JointForce):
    """f_0."""

    name = "constant_force"
    symbols = (Symbol("f_0", "{f}"),)

    @staticmethod
    def force(q, v, f_0):
        return f_0


class PositionRipple(JointForce):
    """s sin(n q) + c cos(n q): the magnets' detent, or a gear's.

    On a hinge n is at least 1.9 waves a turn: slower ones imitate gravity. And it is at least one
    over the places that the joint was at: less of a wave imitates an offset and a spring.
    """

    name = "position_ripple"
    symbols = (
        Symbol("s", "{f}"),
        Symbol("c", "{f}"),
        Symbol("n", "1/{q}", 10.0, 1.9, within=("wave", 1.0, np.inf)),
    )
    fastest = 40.0
    """to which waves are sought, where these are not too many [1/{q}]: slots of usual motors"""
    counts = 60, 240
    """of waves that are tried, at least and at most, for the cost"""

    @staticmethod
    def force(q, v, s, c, n):
        return s * sin(n * q) + c * cos(n * q)

    def probes(self, scale: Scale) -> list[Probe]:
        small = SMALL * scale.force
        # neighbouring waves are half a period apart over the range that was visited
        step = np.pi / max(2.0 * scale.position, 1.0)
        slowest = max(2.0, self.symbols[2].bounds(scale)[0])
        count = np.clip((self.fastest - slowest) / step, *self.counts)
        waves = slowest + step * np.arange(int(count))
        return [Probe(np.array([[small, 0.0, n], [0.0, small, n]])) for n in waves]
