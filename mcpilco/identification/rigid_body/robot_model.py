"""Parameters put into a MuJoCo model: to write its MJCF, and to simulate it as it was recorded.

The simulation runs under the PD feedback that the log shows,

    tau = K_p (q_r - q) + K_d (q_r' - q')

The gains are found in the log: the feedback saw the encoders' noise itself, so that regression of
its forces on errors as they were measured is not biased. The simulated motion follows from the
reference and the parameters alone, without any noise of the log: that is what the instruments of
`noisy_inputs.refine` need.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from mcpilco.bodies import INERTIAL
from mcpilco.identification.rigid_body.body import RigidBody, about_center, check_links
from mcpilco.mjcf import FAR, Inertials, save_mjcf, write_joint_terms
from mcpilco.recordings import JointMotion
from mcpilco.typing import InputError


def write_identified_mjcf(
    source: str | Path, body: RigidBody, theta: np.ndarray, path: str | Path
) -> None:
    """Writes the model with these parameters; plain MuJoCo loads it.

    A body's mass, center and inertia hold all that moves with it. MuJoCo's own writer saves the
    model: with what the file included, without its comments, numbers to six digits.

    Theta (D,) is in the units of `body.units`, of bodies that can exist.

    Raises:
        InputError: no body has such parameters, or MuJoCo refuses the model.
        RunFolderError: the file cannot be written.
    """
    wrong = [str(link) for link in check_links(body, theta) if not link.consistent]
    if wrong:
        raise InputError(
            f"parameters of bodies that can exist were expected, got {'; '.join(wrong)}; project "
            "them on consistent ones."
        )
    source, path = Path(source), Path(path)
    spec = mujoco.MjSpec.from_file(str(source))
    spec.compiler.fusestatic = False
    inertials = Inertials(spec.compile())
    joints = {joint.name: joint for joint in spec.joints}
    for link, block in zip(body.chain.bodies, theta.reshape(-1, body.width), strict=True):
        inertials.replace(link.name, *about_center(block[: len(INERTIAL)]))
        terms = dict(zip(body.terms, block[len(INERTIAL) :], strict=True))
        write_joint_terms(joints[link.joint], terms, bool(spec.compiler.degree))
    inertials.write(spec)
    save_mjcf(spec, source, path)


EXPLAINED = 0.5
"""share of a joint's force that feedback must explain to be taken for its cause [-]"""
LOST = 10.0
"""distance from the reference at which a simulation is given up [rad or m]"""
_OFF = mujoco.mjtDisableBit.mjDSBL_ACTUATION | mujoco.mjtDisableBit.mjDSBL_CONTACT
_TERMS = {
    "viscous": "dof_damping",
    "coulomb": "dof_frictionloss",
    "armature": "dof_armature",
    "stiffness": "jnt_stiffness",
}


@dataclass(frozen=True)
class Feedback:
    """PD gains, joint by joint."""

    position: Float[np.ndarray, " J"]
    """K_p [N m/rad or N/m]"""
    velocity: Float[np.ndarray, " J"]
    """K_d [N m s/rad or N s/m]"""

    @classmethod
    def of(cls, motion: JointMotion, commanded: JointMotion, joints: tuple[str, ...]) -> Feedback:
        """The feedback that explains a log's forces.

        Both motions are of the same times, by the same filter.

        Raises:
            InputError: errors of position and velocity do not explain a joint's force.
        """
        gains = []
        for j, joint in enumerate(joints):
            error = np.column_stack(
                [commanded.q[:, j] - motion.q[:, j], commanded.dq[:, j] - motion.dq[:, j]]
            )
            force = motion.tau[:, j]
            found = np.linalg.lstsq(error, force, rcond=None)[0]
            share = 1.0 - ((force - error @ found) ** 2).sum() / max((force**2).sum(), 1e-300)
            if share < EXPLAINED or found[0] <= 0.0:
                raise InputError(
                    "IDIM-IV simulates the PD feedback that moved the robot; errors of position "
                    f"and velocity explain {max(share, 0.0):.0%} of the force of joint {joint!r}, "
                    f"at least {EXPLAINED:.0%} were expected; record under feedback alone, or "
                    "choose method IV."
                )
            gains.append(found)
        position, velocity = np.array(gains).T
        return cls(position, np.maximum(velocity, 0.0))


def with_parameters(
    model: mujoco.MjModel, body: RigidBody, theta: Float[np.ndarray, " D"]
) -> mujoco.MjModel:
    """A copy of a model that has these parameters.

    The body was made of it, with at most one joint a body; theta is of bodies that can exist.
    """
    changed = copy.deepcopy(model)
    for b in range(1, model.nbody):  # what is welded to a body that moves is part of its link
        if model.body_weldid[b] != b and model.body_weldid[b] != 0:
            changed.body_mass[b], changed.body_inertia[b] = 0.0, 0.0
    for j, block in enumerate(theta.reshape(-1, body.width)):
        b = model.jnt_bodyid[j]
        m, c, inertia = about_center(block[: len(INERTIAL)])
        values, axes = np.linalg.eigh(inertia)
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        changed.body_mass[b], changed.body_ipos[b] = m, model.jnt_pos[j] + c
        changed.body_inertia[b] = values
        mujoco.mju_mat2Quat(changed.body_iquat[b], axes.ravel())
        terms = dict(zip(body.terms, block[len(INERTIAL) :], strict=True))
        for term in _TERMS.keys() & terms.keys():
            getattr(changed, _TERMS[term])[j] = terms[term]
        if "offset" in terms:  # a constant force, as where the joint's spring is at rest
            k = changed.jnt_stiffness[j] or abs(terms["offset"]) / FAR
            changed.jnt_stiffness[j] = k
            changed.qpos_spring[j] = -terms["offset"] / k if k else 0.0
    spring = changed.qpos_spring.copy()
    mujoco.mj_setConst(changed, mujoco.MjData(changed))
    changed.qpos_spring[:] = spring  # which it sets to the model's
    return changed


def follow_reference(
    model: mujoco.MjModel, reference: Float[np.ndarray, "T J"], dt: float, feedback: Feedback
) -> Float[np.ndarray, "T J"]:
    """Positions of a robot under feedback, as often as its reference [rad or m].

    The robot's actuators, contacts and limits are left out.
    """
    model, steps = copy.deepcopy(model), max(1, math.ceil(dt / model.opt.timestep - 1e-9))
    model.opt.timestep = h = dt / steps
    model.opt.disableflags |= int(_OFF)
    model.jnt_limited[:] = 0
    data = mujoco.MjData(model)
    rate = np.gradient(reference, dt, axis=0)
    data.qpos[:], data.qvel[:] = reference[0], rate[0]
    found = np.empty_like(reference)
    K_p, K_d = feedback.position, feedback.velocity
    for k in range(len(reference)):
        found[k] = data.qpos
        for step in range(steps):
            wanted = reference[k] + step * h * rate[k]
            data.qfrc_applied[:] = K_p * (wanted - data.qpos) + K_d * (rate[k] - data.qvel)
            mujoco.mj_step(model, data)
        if not (np.abs(data.qpos - reference[k]) < LOST).all():
            raise InputError(
                f"the simulated robot left its reference after {k * dt:.3g} s, with the "
                "parameters found so far; choose method IV."
            )
    return found
