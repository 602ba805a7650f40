"""The layout of a plant, by name, and its numbers, as arrays for the compiled loops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mcpilco.bodies import Chains

if TYPE_CHECKING:
    from mcpilco.plant.effects.learned import Learned


@dataclass(frozen=True)
class Layout:
    """Names of a plant's joints, bodies, states and inputs; joint j moves body j."""

    joints: tuple[str, ...]
    """in the order of q"""
    slides: tuple[bool, ...]
    """which of them are slides; the others are hinges"""
    bodies: tuple[str, ...]
    """one on each joint"""
    states: tuple[str, ...]
    """q1, q1', q2, q2', ..., as a recording's columns are named"""
    inputs: tuple[str, ...]
    """commands, as a recording's columns are named"""
    drives: tuple[int, ...]
    """the joint that each input drives"""

    @property
    def hinges(self) -> tuple[str, ...]:
        """The joints that are no slides."""
        return tuple(j for j, slide in zip(self.joints, self.slides, strict=True) if not slide)

    @property
    def driven(self) -> tuple[str, ...]:
        """The joints that have an actuator."""
        return tuple(joint for j, joint in enumerate(self.joints) if j in self.drives)

    def actuator(self, number: int) -> str:
        """The name of the actuator of an input: `actuator` where there is one only."""
        return "actuator" if len(self.inputs) == 1 else self.inputs[number]

    @property
    def actuators(self) -> tuple[str, ...]:
        """The names of the actuators."""
        return tuple(map(self.actuator, range(len(self.inputs))))

    def joint_of(self, target: str) -> int:
        """The joint that a joint, body, actuator or state belongs to."""
        if target in self.actuators:
            return self.drives[self.actuators.index(target)]
        if target in self.states:
            return self.states.index(target) // 2
        return (self.joints if target in self.joints else self.bodies).index(target)

    def unit_of(self, target: str) -> tuple[str, str]:
        """Units of position and force at the joint that a target belongs to."""
        return ("m", "N") if self.slides[self.joint_of(target)] else ("rad", "N m")

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the states."""
        positions = [self.unit_of(joint)[0] for joint in self.joints]
        return tuple(unit for x in positions for unit in (x, f"{x}/s"))


GAIN, DEAD_ZONE, LIMIT, DELAY, LAG, PLAY, RANGE, DEAD_BELOW, RATE = range(9)
"""columns of `Tables.actuators`: [-], [force], [force], [s], [s], [force], [command], [force],
[force/s]; a dead zone's ends above 0 and below it may differ"""
OFFSET, SCALE, LATENCY, FILTER, SINE, COSINE = range(6)
"""columns of `Tables.sensors`: [state], [-], [s], [s], [state], [state]"""
IDEAL_ACTUATOR = (1.0, 0.0, np.inf, 0.0, 0.0, 0.0, np.inf, 0.0, np.inf)
IDEAL_SENSOR = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0)


CONSTANTS = 4
"""most parameters that a force in a joint has"""


class Tables(NamedTuple):
    """The numbers of S systems of one plant, as arrays for the compiled loops."""

    chains: Chains
    """their bodies"""
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
    actuators: Float[np.ndarray, "S U 9"]
    """from command to force, see `GAIN` to `RATE`"""
    sensors: Float[np.ndarray, "S X 6"]
    """from state to measurement, see `OFFSET` to `COSINE`"""
    learned: Learned
    """forces in joints that no formula gives"""
