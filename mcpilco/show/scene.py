"""The picture of an environment in 3D: shapes, and where they are in each state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from mcpilco.bodies import HINGE, Body, Chain


@dataclass(frozen=True)
class Shape:
    """One rigid body, drawn as a box, a capsule or a sphere, centred at its own origin."""

    kind: Literal["box", "capsule", "sphere"]
    size: tuple[float, ...]
    """box: half lengths along x, y, z; capsule: radius, half length along z; sphere: radius [m]"""
    color: tuple[int, int, int]
    """red, green, blue in 0..255"""


@dataclass(frozen=True)
class Pose:
    """Where one body is, for each of T states."""

    translation: Float[np.ndarray, "T 3"]
    """centre [m]"""
    quaternion: Float[np.ndarray, "T 4"]
    """rotation of the body into the world, order x, y, z, w [-]"""


@dataclass(frozen=True)
class Scene:
    """An environment's picture. `z` points up."""

    shapes: Mapping[str, Shape]
    """bodies that move, by name"""
    poses: Callable[[Float[np.ndarray, "T X"]], Mapping[str, Pose]]
    """the pose of every body for each state"""
    marker: Callable[[Float[np.ndarray, "*b X"]], Float[np.ndarray, "*b 3"]]
    """one point that stands for a state, such as a pole's tip; particles are drawn by it [m]"""
    fixed: tuple[tuple[Shape, tuple[float, float, float]], ...] = ()
    """bodies that never move, and where they are [m]"""
    target: tuple[float, float, float] | None = None
    """where the marker should go [m]"""


_COLORS = ((214, 140, 69), (86, 140, 200), (120, 170, 90), (190, 100, 120))
"""of the bodies, in turn"""
_FRAME = (110, 116, 130)
"""of what does not move"""
_THICK = 0.05
"""radius of a link, in lengths of the longest [-]"""
_POINT = 0.5
"""size of a scene whose bodies have no length at all [m]"""
_SHORTEST = 0.1
"""length of a body that has none, in lengths of the longest [-]"""


def chain_scene(chain: Chain) -> Scene:
    """Links as capsules from joint to joint, sliding bodies as boxes; the marker is the last tip.

    A link that carries no other ends at twice the way to its center of mass, as a rod would.
    """
    tips = _tips(chain)
    size = float(np.linalg.norm(tips, axis=1).max()) or _POINT
    radius = _THICK * size
    shapes = {}
    for number, body in enumerate(chain.bodies):
        color = _COLORS[number % len(_COLORS)]
        half = 0.5 * float(np.linalg.norm(tips[number]))
        if half > 0.5 * _SHORTEST * size:
            shapes[body.name] = Shape("capsule", (radius, half), color)
        else:
            shapes[body.name] = Shape("box", (4 * radius, 2 * radius, 2 * radius), color)

    def poses(states: Float[np.ndarray, "T X"]) -> Mapping[str, Pose]:
        found = {}
        for number, (R, p) in enumerate(_frames(chain, states[:, 0::2])):
            along = R * _turned_to(tips[number])
            centre = p + R.apply(0.5 * tips[number])
            found[chain.bodies[number].name] = Pose(centre, along.as_quat())
        return found

    def marker(states: Float[np.ndarray, "*b X"]) -> Float[np.ndarray, "*b 3"]:
        flat = states.reshape(-1, states.shape[-1])
        R, p = _frames(chain, flat[:, 0::2])[-1]
        return (p + R.apply(tips[-1])).reshape(*states.shape[:-1], 3)

    base = Shape("box", (2 * radius, 2 * radius, 2 * radius), _FRAME)
    fixed = [(base, body.origin) for body in chain.bodies if body.parent < 0 and body.kind == HINGE]
    return Scene(shapes=shapes, poses=poses, marker=marker, fixed=tuple(fixed))


def _tips(chain: Chain) -> Float[np.ndarray, "J 3"]:
    """Where each body ends, in its own frame [m]."""

    def tip(number: int, body: Body) -> np.ndarray:
        carried = [b for b in chain.bodies if b.parent == number]
        ends = [np.array(b.origin) for b in carried] or [_end(body)]
        return max(ends, key=lambda end: float(np.linalg.norm(end)))

    return np.array([tip(number, body) for number, body in enumerate(chain.bodies)])


def _end(body: Body) -> Float[np.ndarray, " 3"]:
    """The end of a body that carries no other: a point mass, or a rod's."""
    extended = np.any(np.array(body.inertia))
    return (2.0 if extended else 1.0) * np.array(body.center)


def _frames(
    chain: Chain, q: Float[np.ndarray, "T J"]
) -> list[tuple[Rotation, Float[np.ndarray, "T 3"]]]:
    """Rotation into the world and origin of each body's frame, for T positions of the joints."""
    frames: list[tuple[Rotation, np.ndarray]] = []
    for number, body in enumerate(chain.bodies):
        R, p = Rotation.identity(len(q)), np.zeros((len(q), 3))
        if body.parent >= 0:
            R, p = frames[body.parent]
        p = p + R.apply(body.origin)
        R = R * Rotation.from_matrix(np.array(body.rotation))
        axis, moved = np.array(body.axis), q[:, number, None]
        if body.kind == HINGE:
            R = R * Rotation.from_rotvec(moved * axis)
        else:
            p = p + R.apply(moved * axis)
        frames.append((R, p))
    return frames


def _turned_to(tip: Float[np.ndarray, " 3"]) -> Rotation:
    """The rotation that takes the z axis, along which a capsule lies, to a tip."""
    size = np.linalg.norm(tip)
    if size == 0.0:
        return Rotation.identity()
    return Rotation.align_vectors(tip[None] / size, np.array([[0.0, 0.0, 1.0]]))[0]
