"""What moves in a plant, by name."""

from __future__ import annotations

from dataclasses import dataclass


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

    def actuator(self, number: int) -> str:
        """What the actuator of an input is called: `actuator` where there is one only."""
        return "actuator" if len(self.inputs) == 1 else self.inputs[number]

    @property
    def actuators(self) -> tuple[str, ...]:
        """What the actuators are called."""
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
