"""The states of a MuJoCo model: [q1, q1', q2, ...], one pair for each degree of freedom.

A hinge or slide has MuJoCo's own numbers. Of a free or ball joint the orientation is a rotation
vector r, whose quaternion is exp(r / 2), and its velocity that about the body's own axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

_FREE, _BALL = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)


@dataclass(frozen=True)
class Coordinates:
    """Where the positions of J degrees of freedom are in `qpos`."""

    size: int
    """of qpos"""
    dofs: Int[np.ndarray, " n"]
    """those that are numbers of qpos themselves"""
    places: Int[np.ndarray, " n"]
    """of these in qpos"""
    turned: Int[np.ndarray, " r"]
    """the first of the three degrees of freedom of each orientation"""
    quaternions: Int[np.ndarray, " r"]
    """the place of each orientation's quaternion in qpos"""

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Coordinates:
        """Those of a model."""
        dofs: list[int] = []
        places: list[int] = []
        turned: list[int] = []
        quaternions: list[int] = []
        for kind, q, v in zip(model.jnt_type, model.jnt_qposadr, model.jnt_dofadr, strict=True):
            if kind == _BALL:
                turned.append(v)
                quaternions.append(q)
                continue
            plain = 3 if kind == _FREE else 1
            dofs += range(v, v + plain)
            places += range(q, q + plain)
            if kind == _FREE:
                turned.append(v + 3)
                quaternions.append(q + 3)
        return cls(model.nq, *(np.array(n, int) for n in (dofs, places, turned, quaternions)))

    def qpos(self, q: Float[np.ndarray, "*b J"]) -> Float[np.ndarray, "*b Q"]:
        """MuJoCo's positions."""
        qpos = np.zeros((*q.shape[:-1], self.size))
        qpos[..., self.places] = q[..., self.dofs]
        for dof, place in zip(self.turned, self.quaternions, strict=True):
            turn = _rotations(q[..., dof : dof + 3]).as_quat(scalar_first=True)
            qpos[..., place : place + 4] = turn.reshape(*q.shape[:-1], 4)
        return qpos

    def positions(self, qpos: Float[np.ndarray, "*b Q"]) -> Float[np.ndarray, "*b J"]:
        """The positions of the degrees of freedom."""
        q = np.zeros((*qpos.shape[:-1], len(self.dofs) + 3 * len(self.turned)))
        q[..., self.dofs] = qpos[..., self.places]
        for dof, place in zip(self.turned, self.quaternions, strict=True):
            quaternion = qpos[..., place : place + 4].reshape(-1, 4)
            known = np.isfinite(quaternion).all(axis=1) & quaternion.any(axis=1)
            turn = np.full((len(quaternion), 3), np.nan)
            turn[known] = Rotation.from_quat(quaternion[known], scalar_first=True).as_rotvec()
            q[..., dof : dof + 3] = turn.reshape(*q.shape[:-1], 3)
        return q

    def beside(
        self, y: Float[np.ndarray, "... X T"], measured: Float[np.ndarray, "... X T"]
    ) -> Float[np.ndarray, "... X T"]:
        """States whose orientations differ from measured ones by the rotation from one to other.

        That is their difference in the tangent space, as `mj_differentiatePos` has it.
        """
        y, measured = y.copy(), np.broadcast_to(measured, y.shape)
        for dof in self.turned:
            rows = [2 * dof, 2 * dof + 2, 2 * dof + 4]
            ours, theirs = (np.moveaxis(part[..., rows, :], -2, -1) for part in (y, measured))
            known = np.isfinite(ours).all(axis=-1) & np.isfinite(theirs).all(axis=-1)
            between = _rotations(ours[known]).inv() * _rotations(theirs[known])
            near = ours.copy()
            near[known] = theirs[known] - between.as_rotvec()
            y[..., rows, :] = np.moveaxis(near, -1, -2)
        return y


def states(q: Float[np.ndarray, "*b J"], v: Float[np.ndarray, "*b J"]) -> Float[np.ndarray, "*b X"]:
    """Positions and velocities, as a plant's states are ordered."""
    return np.stack([q, v], axis=-1).reshape(*q.shape[:-1], -1)


def _rotations(vectors: Float[np.ndarray, "*b 3"]) -> Rotation:
    return Rotation.from_rotvec(vectors.reshape(-1, 3))
