"""The layout of a plant, by name, and its numbers, as arrays for the compiled loops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

if TYPE_CHECKING:
    from mcpilco.plant.effects.learned import Learned


@dataclass(frozen=True)
class Layout:
    """Names of a plant's joints, bodies, states and inputs.

    A free or ball joint is several: slides x, y, z, and hinges rx, ry, rz, whose positions are the
    rotation vector of its orientation and whose velocities are those about the body's own axes.
    """

    joints: tuple[str, ...]
    """in the order of q"""
    slides: tuple[bool, ...]
    """which of them are slides; the others are hinges"""
    bodies: tuple[str, ...]
    """what moves with joints: one on each, where `carriers` are not given"""
    states: tuple[str, ...]
    """q1, q1', q2, q2', ..., as a recording's columns are named"""
    inputs: tuple[str, ...]
    """commands, as a recording's columns are named"""
    drives: tuple[int, ...]
    """the joint that each input drives; of those that it drives, the one that it drives most"""
    carriers: tuple[int, ...] = ()
    """the joint of each body; where empty, joint j moves body j"""
    floating: tuple[int, ...] = ()
    """joints that are parts of a free or ball joint: no bearing rubs in them"""
    orientations: tuple[int, ...] = ()
    """the first of the three hinges of each orientation"""
    targets: tuple[str, ...] = ()
    """of each input that is the target of a servo, its unit; empty where it asks for a force"""
    contacts: tuple[str, ...] = ()
    """what touches others: "ground" where anything does"""

    @property
    def guided(self) -> tuple[str, ...]:
        """The joints that have a bearing: all but those of free and ball joints."""
        return tuple(name for j, name in enumerate(self.joints) if j not in self.floating)

    @property
    def hinges(self) -> tuple[str, ...]:
        """Those of them that are no slides."""
        return tuple(n for n in self.guided if not self.slides[self.joints.index(n)])

    @property
    def turning(self) -> tuple[str, ...]:
        """The bodies that turn about a hinge."""
        hinges = [self.joints.index(name) for name in self.hinges]
        return tuple(body for body in self.bodies if self.joint_of(body) in hinges)

    @property
    def servos(self) -> tuple[str, ...]:
        """The actuators whose command is a target."""
        return tuple(a for a, unit in zip(self.actuators, self.targets, strict=False) if unit)

    @property
    def driven(self) -> tuple[str, ...]:
        """The joints that have an actuator."""
        return tuple(n for n in self.guided if self.joints.index(n) in self.drives)

    def actuator(self, number: int) -> str:
        """The name of the actuator of an input: `actuator` where there is one only."""
        return "actuator" if len(self.inputs) == 1 else self.inputs[number]

    @property
    def actuators(self) -> tuple[str, ...]:
        """The names of the actuators."""
        return tuple(map(self.actuator, range(len(self.inputs))))

    def joint_of(self, target: str) -> int:
        """The joint that a joint, body, actuator or state belongs to; the first of the ground."""
        if target in self.contacts:
            return 0
        if target in self.actuators:
            return self.drives[self.actuators.index(target)]
        if target in self.states:
            return self.states.index(target) // 2
        if target in self.joints:
            return self.joints.index(target)
        body = self.bodies.index(target)
        return self.carriers[body] if self.carriers else body

    def unit_of(self, target: str) -> tuple[str, str]:
        """Units of position and force at the joint that a target belongs to.

        Of a servo the second is the unit of its target; of the ground they are m and N.
        """
        slides = target in self.contacts or self.slides[self.joint_of(target)]
        position, force = ("m", "N") if slides else ("rad", "N m")
        if target in self.servos:
            return position, self.targets[self.actuators.index(target)]
        return position, force

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the states."""
        positions = [self.unit_of(joint)[0] for joint in self.joints]
        return tuple(unit for x in positions for unit in (x, f"{x}/s"))


GAIN, DEAD_ZONE, LIMIT, DELAY, LAG, PLAY, RANGE, DEAD_BELOW, RATE = range(9)
MIDDLE, FORCE, STIFF, DAMPED, BIAS, STRONGEST = range(9, 15)
"""columns of `Tables.actuators`: [-], [force], [force], [s], [s], [force], [command], [force],
[force/s], [command], [-], [force/position], [force/velocity], [force], [force]; a dead zone's ends
above 0 and below it may differ; the last five are a servo's, for which the target is the force"""
OFFSET, SCALE, LATENCY, FILTER, SINE, COSINE = range(6)
"""columns of `Tables.sensors`: [state], [-], [s], [s], [state], [state]"""
IDEAL_ACTUATOR = (
    *(1.0, 0.0, np.inf, 0.0, 0.0, 0.0, np.inf, 0.0, np.inf),
    *(0.0, 1.0, 0.0, 0.0, 0.0, np.inf),
)
IDEAL_SENSOR = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)


CONSTANTS = 4
"""most parameters that a force in a joint has"""


class Tables(NamedTuple):
    """The numbers of S systems of one plant, as arrays for the compiled loops."""

    chains: Any
    """their bodies: of equations `Chains`; where MuJoCo simulates, a compiled model each"""
    law: Int[np.ndarray, " L"]
    """forces in joints: the formula of each, see `mcpilco.plant.simulation.laws.code_of`"""
    joint: Int[np.ndarray, " L"]
    """the joint of each"""
    constants: Float[np.ndarray, "S L 4"]
    """the parameters of each"""
    turn: Float[np.ndarray, "S L"]
    """velocity over which each turns over [m/s or rad/s]; 0 if it is no dry friction"""
    drives: Int[np.ndarray, " U"]
    """the joint that each input drives"""
    actuators: Float[np.ndarray, "S U 15"]
    """from command to force, see `GAIN` to `STRONGEST`"""
    sensors: Float[np.ndarray, "S X 6"]
    """from state to measurement, see `OFFSET` to `COSINE`"""
    learned: Learned
    """forces in joints that no formula gives"""
