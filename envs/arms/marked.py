"""Arms with a marker on every link, and the log of a fixed camera that looks at them.

They are made of tables of Denavit and Hartenberg's parameters, as MuJoCo models.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import pi
from typing import Any, Literal

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from mcpilco.recordings import MarkerRecording

Kind = Literal["hinge", "slide"]


@dataclass(frozen=True)
class Link:
    """A row of the table: the joint before a link, and the frame that it carries.

    The frame is reached from that of the link before by Rz(theta) Tz(d) Tx(a) Rx(alpha); the joint
    adds its position to theta or to d.

    Reference: thesis eqs. (2.2) and (2.3).
    """

    kind: Kind
    theta: float = 0.0
    """[rad]"""
    d: float = 0.0
    """[m]"""
    a: float = 0.0
    """[m]"""
    alpha: float = 0.0
    """[rad]"""


def random_links(rng: np.random.Generator, joints: int) -> tuple[Link, ...]:
    """A chain of hinges and slides in random order; some axes are parallel."""
    kinds: tuple[Kind, Kind] = ("hinge", "slide")
    return tuple(
        Link(
            kind=kinds[int(rng.integers(2))],
            theta=rng.uniform(-pi, pi),
            d=rng.uniform(-0.4, 0.4),
            a=rng.uniform(0.1, 0.4),
            alpha=float(rng.choice([0.0, pi / 2, -pi / 2, rng.uniform(-pi, pi)])),
        )
        for _ in range(joints)
    )


def arm(links: Sequence[Link]) -> mujoco.MjSpec:
    """A model with the bodies `link0`, which stands still, to `linkN`, and joints `joint1` to N.

    The frame of a body is the link's of the table, at q = 0.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="link0")
    for number, link in enumerate(links, start=1):
        turned = Rotation.from_euler("ZX", [link.theta, link.alpha])
        origin = np.array([link.a * np.cos(link.theta), link.a * np.sin(link.theta), link.d])
        body = body.add_body(
            name=f"link{number}", pos=origin, quat=turned.as_quat(scalar_first=True)
        )
        hinge = link.kind == "hinge"
        body.add_joint(
            name=f"joint{number}",
            type=mujoco.mjtJoint.mjJNT_HINGE if hinge else mujoco.mjtJoint.mjJNT_SLIDE,
            axis=turned.inv().apply([0.0, 0.0, 1.0]),  # the z axis of the frame before,
            pos=turned.inv().apply(-origin),  # through its origin
        )
        body.add_geom(size=[0.03, 0.0, 0.0], mass=1.0)
    return spec


@dataclass(frozen=True)
class Camera:
    """Errors of marker poses, and of the joint positions that are logged with them.

    Reference: thesis section 2.4.2.
    """

    position_std: float = 0.003
    """of each coordinate of a marker [m]"""
    orientation_std: float = 0.01
    """of each component of the rotation vector by which a marker is seen turned [rad]"""
    reliable: float = 4.0
    """distance beyond which both grow with its square [m]"""
    outliers: float = 0.0
    """share of poses that are wrong by decimetres and tens of degrees [-]"""
    missing: float = 0.0
    """share of poses that are not seen [-]"""
    encoder_std: float = 0.0
    """of the joint positions [rad or m]"""

    def look(
        self,
        positions: Float[np.ndarray, "N markers 3"],
        orientations: Rotation,
        rng: np.random.Generator,
    ) -> tuple[Float[np.ndarray, "N markers 3"], Float[np.ndarray, "N markers 4"]]:
        """Measured positions [m] and quaternions, NaN where a marker is not seen."""
        shape = positions.shape
        grown = np.maximum(np.linalg.norm(positions, axis=-1) / self.reliable, 1.0) ** 2
        wrong = rng.random(shape[:2]) < self.outliers
        position_std = np.where(wrong, 0.3, self.position_std * grown)[..., None]
        orientation_std = np.where(wrong, 1.0, self.orientation_std * grown)[..., None]
        seen = positions + position_std * rng.standard_normal(shape)
        turn = Rotation.from_rotvec((orientation_std * rng.standard_normal(shape)).reshape(-1, 3))
        turned = (turn * orientations).as_quat(scalar_first=True).reshape(*shape[:2], 4)
        hidden = rng.random(shape[:2]) < self.missing
        seen[hidden], turned[hidden] = np.nan, np.nan
        return seen, turned


IDEAL = Camera(position_std=0.0, orientation_std=0.0)
"""without any error"""


@dataclass(frozen=True)
class MarkedArm:
    """A chain whose links carry markers, seen by a camera; neither tells its place in the chain."""

    model: Any
    """mujoco.MjModel with a site for each marker and the site `camera`"""
    kinds: tuple[Kind, ...]
    """of the joints, along the chain"""
    markers: tuple[str, ...]
    """names of the markers, along the chain from the base"""
    joints: tuple[str, ...]
    """names of the joints' columns, along the chain"""
    _data: Any = field(repr=False, compare=False)

    def poses(
        self, q: Float[np.ndarray, "N J"]
    ) -> tuple[Float[np.ndarray, "N markers 3"], Rotation]:
        """True poses in the camera's frame, along the chain; N times `markers` rotations."""
        sites = [self.model.site(name).id for name in self.markers]
        camera = self.model.site("camera").id
        positions = np.empty((len(q), len(sites), 3))
        matrices = np.empty((len(q), len(sites), 3, 3))
        for row, joints in enumerate(q):
            self._data.qpos[:] = joints
            mujoco.mj_kinematics(self.model, self._data)
            R_wc = self._data.site_xmat[camera].reshape(3, 3)
            positions[row] = (self._data.site_xpos[sites] - self._data.site_xpos[camera]) @ R_wc
            matrices[row] = R_wc.T @ self._data.site_xmat[sites].reshape(-1, 3, 3)
        return positions, Rotation.from_matrix(matrices.reshape(-1, 3, 3))

    def log(
        self,
        time: Float[np.ndarray, " N"],
        q: Float[np.ndarray, "N J"],
        camera: Camera,
        rng: np.random.Generator,
    ) -> Mapping[str, Float[np.ndarray, " N"]]:
        """Named columns as `mcpilco kinematics` reads them; sorted names give nothing away."""
        positions, quaternions = camera.look(*self.poses(q), rng)
        measured = q + camera.encoder_std * rng.standard_normal(q.shape)
        joints, markers = np.argsort(self.joints), np.argsort(self.markers)
        return MarkerRecording(
            time,
            measured[:, joints],
            positions[:, markers],
            quaternions[:, markers],
            tuple(self.joints[j] for j in joints),
            tuple(self.markers[m] for m in markers),
        ).columns()


def marked_arm(links: Sequence[Link], rng: np.random.Generator, distance: float = 2.0) -> MarkedArm:
    """An arm with markers and a camera at random, each marker near its link.

    The camera is at a `distance` from the arm's base [m].
    """
    spec, count = arm(links), len(links) + 1
    markers = [f"m{number}" for number in rng.permutation(count)]
    joints = [f"q{number}" for number in 1 + rng.permutation(len(links))]
    for place, name in enumerate(markers):
        spec.body(f"link{place}").add_site(
            name=name, pos=rng.uniform(-0.1, 0.1, 3), quat=_random_quaternion(rng)
        )
    away = rng.standard_normal(3)
    spec.worldbody.add_site(
        name="camera", pos=distance * away / np.linalg.norm(away), quat=_random_quaternion(rng)
    )
    model = spec.compile()
    kinds = tuple(link.kind for link in links)
    return MarkedArm(model, kinds, tuple(markers), tuple(joints), mujoco.MjData(model))


def random_marked_arm(rng: np.random.Generator, joints: int) -> MarkedArm:
    """`marked_arm` of `random_links`."""
    return marked_arm(random_links(rng, joints), rng)


def _random_quaternion(rng: np.random.Generator) -> Float[np.ndarray, " 4"]:
    return Rotation.random(rng=rng).as_quat(scalar_first=True)
