"""Forces in a joint: friction, springs, and what the motor's magnets do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from mcpilco.plant.effects.base import MOST, Effect, Probe, Scale, Symbol, sizes
from mcpilco.plant.simulation import Layout, Tables, laws

SLOWEST, FASTEST = 5e-4, 0.1
"""velocity over which dry friction may turn over [m/s or rad/s]"""
TURN = Symbol("v_r", "{q}/s", 2e-3, SLOWEST, FASTEST, told=False)
"""dry friction turns over as tanh(v / v_r); every machine has its own v_r"""
SMALL = 0.02
"""of the usual force, that of a probe"""


class JointForce(Effect):
    """A force in a joint, of its position q and velocity v."""

    place = "joint"

    def targets(self, layout: Layout) -> tuple[str, ...]:
        return layout.joints

    def install(self, tables: Tables, system: int, at: int, values: Sequence[float]) -> None:
        tables.constants[system, at, : len(values)] = values

    def largest(self, scale: Scale) -> Float[np.ndarray, " symbols"]:
        probed = np.concatenate([probe.values for probe in self.probes(scale)])
        usual = np.abs(probed).max(axis=0) / SMALL
        return np.where(self.neutral == 0.0, MOST * usual, np.inf)


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


class ViscousFriction(JointForce):
    """-b v."""

    name = "viscous_friction"
    symbols = (Symbol("b", "{f} s/{q}", low=0.0),)
    law = laws.VISCOUS

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(SMALL * scale.force / scale.velocity)]


class CoulombFriction(DryFriction):
    """-f_c sign(v), as -f_c tanh(v / v_r)."""

    name = "coulomb_friction"
    symbols = (Symbol("f_c", "{f}", low=0.0), TURN)
    law = laws.COULOMB

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(SMALL * scale.force, TURN.neutral)]


class StribeckFriction(DryFriction):
    """-(f_c + f_d exp(-(v / v_s)^2)) sign(v): dry friction that is f_d stronger at rest."""

    name = "stribeck_friction"
    special = ("coulomb_friction",)
    symbols = (
        Symbol("f_c", "{f}", low=0.0),
        Symbol("f_d", "{f}", low=0.0),
        Symbol("v_s", "{q}/s", 0.1, 10.0 * SLOWEST, 1.0),
        TURN,
    )
    law = laws.STRIBECK

    def probes(self, scale: Scale) -> list[Probe]:
        small, turn = SMALL * scale.force, TURN.neutral
        speeds = [min(part * scale.velocity, 1.0) for part in (0.03, 0.1, 0.3)]
        return [Probe(np.array([[small, 0.0, v, turn], [0.0, small, v, turn]])) for v in speeds]


class QuadraticDrag(JointForce):
    """-c v |v|."""

    name = "quadratic_drag"
    symbols = (Symbol("c", "{f} s^2/{q}^2", low=0.0),)
    law = laws.QUADRATIC

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(SMALL * scale.force / scale.velocity**2)]


class AsymmetricFriction(DryFriction):
    """-f_p where v > 0, +f_n where v < 0: dry friction of another size in each direction."""

    name = "asymmetric_friction"
    special = ("coulomb_friction",)
    symbols = (Symbol("f_p", "{f}", low=0.0), Symbol("f_n", "{f}", low=0.0), TURN)
    law = laws.ASYMMETRIC

    def probes(self, scale: Scale) -> list[Probe]:
        small = SMALL * scale.force
        return [Probe(np.array([[small, 0.0, TURN.neutral], [0.0, small, TURN.neutral]]))]


class Spring(JointForce):
    """-k q."""

    name = "spring"
    symbols = (Symbol("k", "{f}/{q}", low=0.0),)
    law = laws.SPRING

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(SMALL * scale.force / scale.position)]


class HardeningSpring(JointForce):
    """-k_3 q^3."""

    name = "hardening_spring"
    symbols = (Symbol("k_3", "{f}/{q}^3", low=0.0),)
    law = laws.HARDENING

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(SMALL * scale.force / scale.position**3)]


class ConstantForce(JointForce):
    """f_0."""

    name = "constant_force"
    symbols = (Symbol("f_0", "{f}"),)
    law = laws.CONSTANT

    def probes(self, scale: Scale) -> list[Probe]:
        return [sizes(SMALL * scale.force)]


class PositionRipple(JointForce):
    """s sin(n q) + c cos(n q): the magnets' detent, or a gear's.

    On a hinge n is at least 1.9 waves a turn: slower ones imitate gravity.
    """

    name = "position_ripple"
    symbols = (Symbol("s", "{f}"), Symbol("c", "{f}"), Symbol("n", "1/{q}", 10.0, 1.9))
    law = laws.RIPPLE

    def probes(self, scale: Scale) -> list[Probe]:
        small = SMALL * scale.force
        # neighbouring waves are half a period apart over the range that was visited
        step = np.pi / max(2.0 * scale.position, 1.0)
        waves = np.arange(2.0, 2.0 + 60 * step, step)
        return [Probe(np.array([[small, 0.0, n], [0.0, small, n]])) for n in waves]
