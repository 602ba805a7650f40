"""The nominal plants in the terms of the other simulator."""

from __future__ import annotations

from dataclasses import dataclass

from truth import CART_POLE, DOUBLE_PENDULUM, PENDULUM, ROTARY_PENDULUM

Hidden = tuple[str, str]
"""name and target of an effect"""


@dataclass(frozen=True)
class System:
    """A nominal plant of ours, in the terms of the other simulator."""

    kind: int
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    drives: tuple[int, ...]
    limit: tuple[float, ...]
    """largest command of each input"""
    body: tuple[tuple[float, ...], ...]
    """mass, first moment, inertia about the joint, length"""
    viscous: tuple[float, ...]
    force: tuple[float, ...]
    """usual at each joint"""
    speed: tuple[float, ...]
    slides: tuple[bool, ...]
    swings: tuple[bool, ...]
    """whether gravity pulls at the joint: elsewhere its zero and its center cannot be seen"""
    alike: tuple[frozenset[Hidden], ...]
    """effects that do exactly the same to every motion"""
    alike_in_positions: tuple[frozenset[Hidden], ...] = ()
    """likewise, where no velocity is measured"""

    def synonyms(self, velocities: bool) -> tuple[frozenset[Hidden], ...]:
        """Effects that no recording of ours tells apart."""
        return self.alike if velocities else self.alike + self.alike_in_positions

    def same(self, effect: Hidden, velocities: bool) -> frozenset[Hidden]:
        """An effect, and those that no recording of ours tells from it."""
        told = (synonyms for synonyms in self.synonyms(velocities) if effect in synonyms)
        return next(told, frozenset({effect}))


SYSTEMS = {
    "mcpilco/CartPoleSwingUp-v0": System(
        CART_POLE,
        ("cart_position", "cart_velocity", "pole_angle", "pole_velocity"),
        ("force",),
        ("cart", "pole"),
        ("cart", "pole"),
        (0,),
        (6.0,),
        ((0.5, 0.0, 0.0, 0.0), (0.5, 0.125, 0.5 * 0.25 / 3, 0.5)),
        (0.1, 0.0),
        (3.0, 0.6),
        (0.8, 4.0),
        (True, False),
        (False, True),
        (
            frozenset({("body_mass", "cart"), ("armature", "cart")}),
            frozenset({("body_inertia", "pole"), ("armature", "pole")}),
        ),
    ),
    "mcpilco/Pendulum-v0": System(
        PENDULUM,
        ("angle", "velocity"),
        ("torque",),
        ("pendulum",),
        ("pendulum",),
        (0,),
        (1.5,),
        ((0.6, 0.3, 0.15, 0.5),),
        (0.05,),
        (1.2,),
        (4.0,),
        (False,),
        (True,),
        (
            frozenset({("body_inertia", "pendulum"), ("armature", "pendulum")}),
            frozenset({("sensor_offset", "angle"), ("gravity_tilt", "pendulum")}),
        ),
        (frozenset({("actuator_delay", "actuator"), ("sensor_delay", "angle")}),),
    ),
    "mcpilco/DoublePendulum-v0": System(
        DOUBLE_PENDULUM,
        ("shoulder_angle", "shoulder_velocity", "elbow_angle", "elbow_velocity"),
        ("shoulder_torque", "elbow_torque"),
        ("shoulder", "elbow"),
        ("upper", "lower"),
        (0, 1),
        (1.5, 0.5),
        ((0.6, 0.09, 0.6 * 0.09 / 3, 0.3), (0.4, 0.06, 0.4 * 0.09 / 3, 0.3)),
        (0.01, 0.01),
        (1.2, 0.35),
        (4.0, 5.0),
        (False, False),
        (True, True),
        (
            frozenset({("body_inertia", "upper"), ("armature", "shoulder")}),
            frozenset({("sensor_offset", "shoulder_angle"), ("gravity_tilt", "upper")}),
        ),
    ),
    "rotary_pendulum.xml": System(
        ROTARY_PENDULUM,
        ("arm_position", "arm_velocity", "rod_position", "rod_velocity"),
        ("torque",),
        ("arm", "rod"),
        ("arm", "rod"),
        (0,),
        (0.2,),
        ((0.3, 0.03, 0.004, 0.2), (0.2, 0.04, 0.011, 0.4)),
        (0.02, 0.0005),
        (0.1, 0.25),
        (4.0, 5.0),
        (False, False),
        (False, True),
        (
            frozenset({("body_mass", "arm"), ("body_inertia", "arm"), ("armature", "arm")}),
            frozenset({("body_inertia", "rod"), ("armature", "rod")}),
        ),
    ),
}
