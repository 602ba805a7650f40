"""Masses, centers and inertias of an MJCF model, to be changed as those of a plant are."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from jaxtyping import Float

ROUNDING = 2e-5
"""how far MuJoCo's writer, with its six digits, may change a sum of two numbers [-]"""


class Inertials:
    """Of every body; what is welded to a body moves, and is changed, with it.

    Names are those of the plant's bodies: of the MJCF body that holds the joint.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._mass = model.body_mass.copy()
        self._center = model.body_ipos.copy()
        R = np.array([matrix_of(quaternion) for quaternion in model.body_iquat])
        self._inertia = (R * model.body_inertia[:, None]) @ R.transpose(0, 2, 1)
        self._before = (self._mass.copy(), self._center.copy(), self._inertia.copy())
        self._members: dict[str, dict[int, Float[np.ndarray, "3 3"]]] = {}
        """what moves with a named body: bodies, and the rotations that take them to its frame"""
        self._joints: dict[str, int] = {}
        """the joint of each named body"""
        self._origins = np.zeros((model.nbody, 3))
        """of each body's frame, in the frame of the body that it is welded to [m]"""
        self._gather()

    def _gather(self) -> None:
        model, owner = self._model, [""] * self._model.nbody
        for b in range(1, model.nbody):
            parent = model.body_parentid[b]
            if model.body_jntnum[b]:
                owner[b] = model.body(b).name or f"body{b}"
                self._members[owner[b]] = {b: np.eye(3)}
                self._joints[owner[b]] = model.body_jntadr[b] + model.body_jntnum[b] - 1
            elif owner[parent]:
                owner[b], R = owner[parent], self._members[owner[parent]][parent]
                self._members[owner[b]][b] = R @ matrix_of(model.body_quat[b])
                self._origins[b] = self._origins[parent] + R @ model.body_pos[b]

    def scale_to(self, body: str, mass: float) -> None:
        """Gives a body another mass [kg], its shape and density distribution the same."""
        members = list(self._members[body])
        factor = mass / self._mass[members].sum()
        self._mass[members] *= factor
        self._inertia[members] *= factor

    def add_mass(self, body: str, more: float) -> None:
        """Makes a body heavier [kg], its shape and density distribution the same."""
        self.scale_to(body, self._mass[list(self._members[body])].sum() + more)

    def move_center(self, body: str, further: float) -> None:
        """Moves a body's center of mass away from its joint [m]."""
        members, (_, arm) = self._members[body], self.mass_and_arm(body)
        shift = further * arm / np.linalg.norm(arm)
        for b, R in members.items():
            self._center[b] += R.T @ shift

    def replace(
        self,
        body: str,
        mass: float,
        center: Float[np.ndarray, " 3"],
        inertia: Float[np.ndarray, "3 3"],
    ) -> None:
        """Gives a body all that moves with it; what is welded to it weighs nothing any more.

        Mass [kg], center of mass in the body's frame, from its joint [m], and inertia about it,
        along the axes of that frame [kg m^2].
        """
        b, *welded = self._members[body]
        self._mass[b], self._inertia[b] = mass, inertia
        self._center[b] = self._model.jnt_pos[self._joints[body]] + center
        self._mass[welded], self._inertia[welded] = 0.0, 0.0

    def mass_and_arm(self, body: str) -> tuple[float, Float[np.ndarray, " 3"]]:
        """A body's mass [kg], and where its center of mass is from its joint [m]."""
        members = self._members[body]
        masses = self._mass[list(members)]
        centers = [self._origins[b] + R @ self._center[b] for b, R in members.items()]
        total = float(masses.sum())
        arm = masses @ np.array(centers) / max(total, 1e-300)
        return total, arm - self._model.jnt_pos[self._joints[body]]

    def add_inertia(self, body: str, more: float) -> str | None:
        """Adds to a body's inertia about its joint's axis [kg m^2], or says why it cannot.

        No mass distribution has an inertia about one axis above the sum of those about the two
        others; where all motion is in a plane, these two do not matter and are raised.
        """
        b, joint = next(iter(self._members[body])), self._joints[body]
        axis = self._model.jnt_axis[joint]
        inertia = self._inertia[b] + more * np.outer(axis, axis)
        if not _is_physical(inertia):
            about = axis @ inertia @ axis
            if not self._is_planar() or about <= 0.0:
                return "no mass distribution has such an inertia; MuJoCo would refuse it."
            across = 0.5 * max(about, np.trace(inertia) - about)
            inertia = about * np.outer(axis, axis) + across * (np.eye(3) - np.outer(axis, axis))
        self._inertia[b] = inertia
        return None

    def _is_planar(self) -> bool:
        """Whether all hinges are parallel, wherever the joints are."""
        data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, data)
        axes = data.xaxis[self._model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)]
        return bool(np.allclose(np.abs(axes @ axes[0]), 1.0, atol=1e-6))

    def shifts(self, body: str, more: float) -> Iterator[tuple[int, Float[np.ndarray, " 3"]]]:
        """The bodies that a body carries, and how each moves in its parent if it is longer [m]."""
        model, members = self._model, self._members[body]
        for child in range(1, model.nbody):
            parent = int(model.body_parentid[child])
            if model.body_jntnum[child] and parent in members:
                hinge = model.jnt_pos[model.body_jntadr[child]]
                at = model.body_pos[child] + matrix_of(model.body_quat[child]) @ hinge
                R = members[parent]
                arm = self._origins[parent] + R @ at - model.jnt_pos[self._joints[body]]
                if np.linalg.norm(arm) > 0.0:
                    yield child, R.T @ (more * arm / np.linalg.norm(arm))

    @property
    def _changed(self) -> list[bool]:
        now = (self._mass, self._center, self._inertia)
        return [
            any(not np.array_equal(a[b], c[b]) for a, c in zip(now, self._before, strict=True))
            for b in range(self._model.nbody)
        ]

    def write_into(self, model: mujoco.MjModel) -> None:
        """Writes what was changed into a compiled model, whose constants are then to be set."""
        for b in np.flatnonzero(self._changed):
            mass, center, inertia = (part[b] for part in self._before)
            model.body_mass[b], factor = self._mass[b], self._mass[b] / max(mass, 1e-300)
            scaled = np.allclose(self._inertia[b], factor * inertia, rtol=1e-12, atol=0.0)
            if scaled and np.array_equal(center, self._center[b]):
                model.body_inertia[b] *= factor
                continue
            moments, R = np.linalg.eigh(self._inertia[b])
            if np.linalg.det(R) < 0.0:
                R[:, 0] *= -1.0
            mujoco.mju_mat2Quat(model.body_iquat[b], R.ravel())
            model.body_inertia[b], model.body_ipos[b] = moments, self._center[b]
            model.body_sameframe[b] = 0  # what was at the center of mass stays where it is
            model.geom_sameframe[model.geom_bodyid == b] = 0
            model.site_sameframe[model.site_bodyid == b] = 0

    def write(self, spec: mujoco.MjSpec) -> None:
        """Writes what was changed into the model's specification."""
        changed, compiler = self._changed, spec.compiler
        if not any(changed):
            return
        if compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
            compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
            changed = [True] * self._model.nbody
        if compiler.settotalmass > 0.0:
            compiler.settotalmass = -1.0
            changed = [True] * self._model.nbody
        for body in spec.bodies:
            if body.id > 0 and changed[body.id]:
                if self._mass[body.id] > 0.0:
                    self._write(body)
                elif self._before[0][body.id] > 0.0:
                    body.explicitinertial = False
                    for geom in body.geoms:  # MuJoCo's writer leaves out a body's mass of 0
                        geom.mass = 0.0

    def _write(self, body: mujoco.MjsBody) -> None:
        moments, R = np.linalg.eigh(self._inertia[body.id])
        # a thin rod's are at the edge of what is physical, and must not be rounded over it
        moments[0] = max(moments[0], (1.0 + ROUNDING) * moments[2] - moments[1])
        if np.linalg.det(R) < 0.0:
            R[:, 0] *= -1.0
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, R.ravel())
        body.explicitinertial = True
        body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        body.fullinertia = np.array([np.nan, *[0.0] * 5])
        body.mass, body.ipos = self._mass[body.id], self._center[body.id]
        body.iquat, body.inertia = quaternion, moments


def _is_physical(inertia: Float[np.ndarray, "3 3"]) -> bool:
    """Whether some distribution of masses has this inertia."""
    a, b, c = np.linalg.eigvalsh(inertia)
    return bool(a >= -ROUNDING * c and a + b >= (1.0 - ROUNDING) * c)


def matrix_of(quaternion: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    """The rotation of a unit quaternion."""
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
