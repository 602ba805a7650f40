"""Industrial robots: a SCARA like the AdeptOne, and an arm like a UR10."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from envs.arms.dh import Kind
from mcpilco.bodies import HINGE, SLIDE, Body, Chain, Matrix, Vector

_SCARA: tuple[tuple[str, str, Kind, float, Vector, Vector, Vector], ...] = (
    # name, joint, mass [kg], center [m], edges of a box [m]; origin in the frame before [m]
    ("inner_arm", "shoulder", HINGE, 15.0, (0.2, 0.0, 0.03), (0.5, 0.2, 0.15), (0.0, 0.0, 0.877)),
    ("outer_arm", "elbow", HINGE, 10.0, (0.18, 0.01, 0.05), (0.45, 0.15, 0.15), (0.425, 0.0, 0.0)),
    ("quill", "quill", SLIDE, 2.0, (0.0, 0.0, -0.1), (0.03, 0.03, 0.4), (0.375, 0.0, 0.0)),
    ("load", "tool", HINGE, 2.0, (0.08, 0.02, 0.06), (0.12, 0.06, 0.08), (0.0, 0.0, 0.0)),
)
_ACROSS: Matrix = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0))
"""the quill looks down: z of the last two frames does"""


def scara() -> Chain:
    """Four joints RRPR; arms of 425 mm and 375 mm, a quill of 2 kg, a load of 2 kg off its axis.

    | joint | kind | unit | moves |
    |---|---|---|---|
    | shoulder | hinge | rad | the inner arm about the column |
    | elbow | hinge | rad | the outer arm |
    | quill | slide | m | the quill, down |
    | tool | hinge | rad | the load about the quill |

    The lengths are those of the AdeptOne; masses and inertias are of bodies of such a size.

    Reference: thesis section 3.4.1, whose dynamic parameters are not given.
    """
    bodies = []
    for number, (name, joint, kind, mass, center, edges, origin) in enumerate(_SCARA):
        bodies.append(
            Body(
                name=name,
                joint=joint,
                kind=kind,
                axis=(0.0, 0.0, 1.0),
                parent=number - 1,
                origin=origin,
                mass=mass,
                center=center,
                inertia=_box(mass, *edges),
            )
        )
    bodies[2] = replace(bodies[2], rotation=_ACROSS)
    return Chain(tuple(bodies), gravity=(0.0, 0.0, -9.81))


def _box(mass: float, x: float, y: float, z: float) -> Matrix:
    """Inertia of a solid box of these edges about its center [kg m^2]."""
    c = mass / 12.0
    return _matrix(np.diag([c * (y * y + z * z), c * (x * x + z * z), c * (x * x + y * y)]))


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
                origin=_vector(origin),
                rotation=_matrix(rotation),
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
    return _matrix(across * np.eye(3) + (axial - across) * np.outer(along, along))


def _vector(array: Float[np.ndarray, " 3"]) -> Vector:
    """Three numbers."""
    x, y, z = map(float, array)
    return x, y, z


def _matrix(array: Float[np.ndarray, "3 3"]) -> Matrix:
    """Three rows."""
    x, y, z = map(_vector, array)
    return x, y, z
