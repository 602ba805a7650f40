"""The joints of a chain in space: axes and frames from markers, so that it becomes a plant.

For a joint between two markers, p is the position of the second in the frame of the first, and R
its orientation, as in `triplets`:

    hinge   R = Rot(a, q) R_0,    p = c + R d        slide   R = R_0,    p = c + q a + R d

with the axis a through the point c. A body's frame has the orientation of its marker and lies in
its joint. Where along the axis a hinge lies cannot be seen and does not matter: c is the point
nearest to both markers. Masses cannot be seen either: they are placeholders.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from mcpilco.bodies import SLIDE, Body, Chain, Matrix, Vector
from mcpilco.gp import evenly_spaced
from mcpilco.identification.kinematics.chain import ChainJoint, KinematicChain, Tolerance
from mcpilco.identification.kinematics.triplets import relative
from mcpilco.recordings import MarkerRecording, rotation

MOST = 300
"""samples that a joint is fitted to"""
MASS, RADIUS = 1.0, 0.05
"""of a link whose mass nobody knows: a solid sphere at its joint [kg, m]"""
PARALLEL = 0.02
"""angle below which neighbouring axes are taken for parallel, as machines are built [rad]: the
inertias about what is left of it no recording would tell"""
PULL = 1e-3
"""weight of the distances from the axis to the markers, which fixes c along it [-]"""


def chain_in_space(
    recording: MarkerRecording,
    found: KinematicChain,
    gravity: Vector = (0.0, 0.0, -9.81),
    tolerance: Tolerance | None = None,
) -> Chain:
    """The bodies and joints of a kinematic chain, in the frame of the camera.

    Gravity is in this frame [m/s^2]. Each link weighs as much as a solid sphere in its joint, until
    its mass is identified.
    """
    tolerance = tolerance or Tolerance()
    names = list(recording.marker_names)
    origin, turned = _standing(recording, names.index(found.base))
    bodies: list[Body] = []
    standing = turned
    """orientation of the present link where all joints are at 0"""
    last = np.zeros(3)
    for before, joint in zip(found.markers, found.joints, strict=False):
        pair = names.index(before), names.index(joint.marker)
        R_0, axis, c, d = _fit(recording, pair, joint, tolerance)
        wide = standing.apply(axis)
        if np.linalg.norm(np.cross(wide, last)) < PARALLEL and last.any():
            wide = last * np.sign(wide @ last)
        axis, last = standing.inv().apply(wide), wide
        standing = standing * R_0
        inertia = 0.4 * MASS * RADIUS**2
        bodies.append(
            Body(
                name=joint.marker,
                joint=joint.name,
                kind=joint.kind,
                axis=_vector(R_0.inv().apply(axis)),
                mass=MASS,
                parent=len(bodies) - 1,
                origin=_vector(origin + turned.apply(c)),
                rotation=_matrix((turned * R_0).as_matrix()),
                inertia=_matrix(inertia * np.eye(3)),
            )
        )
        origin, turned = d, Rotation.identity()
    return Chain(tuple(bodies), gravity)


def _standing(recording: MarkerRecording, marker: int) -> tuple[Float[np.ndarray, " 3"], Rotation]:
    """The pose of the marker that stands still."""
    rows = recording.seen[:, marker]
    turns = rotation(recording.quaternions[rows, marker])
    middle = turns[int(np.argmin((turns.mean().inv() * turns).magnitude()))]
    away = (middle.inv() * turns).magnitude()
    near = away <= 3.0 * np.median(away)
    return np.median(recording.positions[rows, marker], axis=0), turns[near].mean()


def _fit(
    recording: MarkerRecording, pair: tuple[int, int], joint: ChainJoint, tolerance: Tolerance
) -> tuple[Rotation, np.ndarray, np.ndarray, np.ndarray]:
    """R_0, a, c and d of a joint, by least squares that wrong poses hardly move."""
    p, r, seen = (part[0] for part in relative(recording, np.array([pair])))
    rows = np.flatnonzero(seen)
    rows = rows[evenly_spaced(len(rows), MOST)]
    q = recording.q[rows, recording.joint_names.index(joint.name)]
    p, R = p[rows], rotation(r[rows])
    slides = joint.kind == SLIDE

    def posed(x: Float[np.ndarray, " 12"]) -> tuple[Rotation, np.ndarray]:
        a = x[3:6] / np.linalg.norm(x[3:6])
        turned = Rotation.from_rotvec(np.outer(q * (not slides), a)) * Rotation.from_rotvec(x[:3])
        return turned, x[6:9] + slides * np.outer(q, a) + turned.apply(x[9:])

    def residuals(x: Float[np.ndarray, " 12"]) -> np.ndarray:
        turned, place = posed(x)
        off = (turned.inv() * R).as_rotvec() / tolerance.orientation
        pull = PULL * np.concatenate([x[6:], [np.linalg.norm(x[3:6]) - 1.0]])
        return np.concatenate([((p - place) / tolerance.position).ravel(), off.ravel(), pull])

    at_0 = R[int(np.abs(q).argmin())].as_rotvec()
    starts = [
        np.concatenate([at_0, axis, p.mean(0), np.zeros(3)])
        for axis in np.concatenate([np.eye(3), -np.eye(3)])
    ]
    fits = [least_squares(residuals, start, loss="soft_l1", f_scale=0.3) for start in starts]
    x = min(fits, key=lambda fit: fit.cost).x
    return Rotation.from_rotvec(x[:3]), x[3:6] / np.linalg.norm(x[3:6]), x[6:9], x[9:]


def _vector(array: Float[np.ndarray, " 3"]) -> Vector:
    x, y, z = map(float, array)
    return x, y, z


def _matrix(array: Float[np.ndarray, "3 3"]) -> Matrix:
    x, y, z = map(_vector, array)
    return x, y, z
