"""An arm with the kinematics of Universal Robots' UR10: six hinges."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from envs.arms.frames import matrix, vector
from mcpilco.bodies import HINGE, Body, Chain, Matrix, Vector

_DH = (
    # a [m], d [m], alpha [rad]: from this joint's frame to the next one's
    (0.0, 0.1273, np.pi / 2),
    (-0.612, 0.0, 0.0),
    (-0.5723, 0.0, 0.0),
    (0.0, 0.163941, np.pi / 2),
    (0.0, 0.1157, -np.pi / 2),
)
_LINKS: tuple[tuple[str, str, float, Vector, float, float, Vector], ...] = (
    # name, joint, mass [kg], center [m], radius [m], length [m] along the direction; each in the
    # frame of its joint, whose axis is z
    ("shoulder", "shoulder_pan", 7.78, (0.02, 0.0, 0.1), 0.075, 0.18, (0.0, 0.0, 1.0)),
    ("upper_arm", "shoulder_lift", 12.93, (-0.306, 0.0, 0.175), 0.075, 0.612, (1.0, 0.0, 0.0)),
    ("forearm", "elbow", 3.87, (-0.286, 0.0, 0.049), 0.06, 0.572, (1.0, 0.0, 0.0)),
    ("wrist_1", "wrist_1", 1.96, (0.0, 0.01, 0.14), 0.06, 0.12, (0.0, 0.0, 1.0)),
    ("wrist_2", "wrist_2", 1.96, (0.0, -0.01, 0.1), 0.06, 0.12, (0.0, 0.0, 1.0)),
    ("tool", "wrist_3", 1.2, (0.03, 0.02, 0.12), 0.06, 0.1, (0.0, 0.0, 1.0)),
)
_ROTORS = (0.4, 0.4, 0.3, 0.1, 0.1, 0.1)
"""inertia of the motors behind their gears, seen from the joints [kg m^2]"""


def ur10() -> Chain:
    """Six joints RRRRRR with the lengths and about the masses of a UR10 that holds 1 kg.

    The links are solid cylinders, so that this is a robot like it, not a model of one.

    Reference: thesis section 3.4.2, where the robot is a real one.
    """
    frames = [(np.zeros(3), np.eye(3))]
    for a, d, alpha in _DH:  # the turn about z is the joint's own, before this transform
        frames.append((np.array([a, 0.0, d]), Rotation.from_euler("x", alpha).as_matrix()))
    bodies = []
    for number, (link, (origin, rotation)) in enumerate(zip(_LINKS, frames, strict=True)):
        name, joint, mass, center, radius, length, along = link
        bodies.append(
            Body(
                name=name,
                joint=joint,
                kind=HINGE,
                axis=(0.0, 0.0, 1.0),
                parent=number - 1,
                origin=vector(origin),
                rotation=matrix(rotation),
                mass=mass,
                center=center,
                inertia=_cylinder(mass, radius, length, np.array(along)),
                armature=_ROTORS[number],
            )
        )
    return Chain(tuple(bodies), gravity=(0.0, 0.0, -9.81))


def _cylinder(mass: float, radius: float, length: float, along: np.ndarray) -> Matrix:
    """Inertia of a solid cylinder about its center [kg m^2]."""
    axial, across = mass * radius**2 / 2.0, mass * (3.0 * radius**2 + length**2) / 12.0
    return matrix(across * np.eye(3) + (axial - across) * np.outer(along, along))
