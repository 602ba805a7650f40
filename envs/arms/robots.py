"""Robots that follow a reference by computed torque: models, control, and what sensors record.

    tau = tau_ff(q_r, q_r', q_r'') + K_p (q_r - q) + K_d (q_r' - q')

q comes from encoders with noise, and q_r' - q' from a low-pass filter of the differences of
q_r - q. The forces of the model depend on the reference alone: they are found beforehand, with any
model. `scara` and `ur10` are industrial robots, as chains.

Reference: An, Atkeson, Hollerbach, Model-based control of a robot manipulator, 1988, chapter 6
    (feedforward control); Ting et al., section IV-B.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float

from envs.arms.motions import Sinusoids, random_sinusoids
from mcpilco.bodies import Chain
from mcpilco.mjcf import chain_of, load_mjcf
from mcpilco.recordings import Recording
from mcpilco.typing import InputError


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
    return chain_of(load_mjcf(Path(__file__).with_name("scara.xml")))


def ur10() -> Chain:
    """Six joints RRRRRR with the lengths and about the masses of a UR10 that holds 1 kg.

    The links are solid cylinders, so that this is a robot like it, not a model of one.

    Reference: thesis section 3.4.2, where the robot is a real one.
    """
    return chain_of(load_mjcf(Path(__file__).with_name("ur10.xml")))


ARMS = {name: Path(__file__).with_name(f"{name}.xml") for name in ("arm_hand", "vision_head")}
"""robots with motors that follow a reference, by name: 10 and 7 joints"""


def load(name: str) -> mujoco.MjModel:
    """The model of a robot.

    Raises:
        InputError: there is no robot of this name.
    """
    if name not in ARMS:
        raise InputError(f"name must be one of {', '.join(ARMS)}, got {name!r}.")
    return mujoco.MjModel.from_xml_path(str(ARMS[name]))


BANDWIDTH = 25.0
"""of the feedback in each joint, with the inertia that it feels on average [rad/s]"""
POSTURES = 64
"""that this is the average of"""
CUTOFF_HZ = 30.0
"""of the filter of the feedback's velocities [Hz]"""
SAFE = 1.0
"""distance from the reference at which the robot is stopped [rad or m]"""


@dataclass(frozen=True)
class Gains:
    """Of the feedback, joint by joint."""

    position: Float[np.ndarray, " J"]
    """K_p [N m/rad or N/m]"""
    velocity: Float[np.ndarray, " J"]
    """K_d [N m s/rad or N s/m]"""

    @classmethod
    def tuned(cls, model: mujoco.MjModel, bandwidth: float = BANDWIDTH) -> Gains:
        """Critical damping at one bandwidth [rad/s], as somebody would tune them on the robot."""
        inertia = _inertia_at_joints(model)
        return cls(bandwidth**2 * inertia, 2.0 * bandwidth * inertia)


@dataclass(frozen=True)
class Followed:
    """The motion of a robot that followed a reference."""

    time: Float[np.ndarray, " T"]
    """of the controller's steps [s]"""
    reference: Float[np.ndarray, "T J"]
    """q_r [rad or m]"""
    position: Float[np.ndarray, "T J"]
    """q, without noise [rad or m]"""
    velocity: Float[np.ndarray, "T J"]
    """q', without noise [rad/s or m/s]"""
    encoder: Float[np.ndarray, "T J"]
    """q as measured [rad or m]"""
    force: Float[np.ndarray, "T J"]
    """tau as applied, within the motors' limits [N m or N]"""
    feedback: Float[np.ndarray, "T J"]
    """the part of the command that corrects errors [N m or N]"""
    stopped: bool
    """whether a joint left its reference by `SAFE`, and the rest did not happen"""


def follow(
    model: mujoco.MjModel,
    reference: Sinusoids,
    seconds: float,
    rng: np.random.Generator,
    *,
    feedforward: Float[np.ndarray, "T J"] | None = None,
    gains: Gains | None = None,
    encoder_std: float = 0.0,
    substeps: int = 2,
) -> Followed:
    """The motion of a robot whose joints all have a motor of gear 1.

    It takes `seconds` [s]. `feedforward` are forces at the controller's steps [N m or N], none by
    default; encoders have white noise of `encoder_std` [rad or m]; a command is held for so many
    `substeps`, timesteps of the model.
    """
    time = control_times(model, seconds, substeps)
    T, J, dt = len(time), model.nv, substeps * model.opt.timestep
    q_r, dq_r, _ = reference.at(time)
    gains = gains or Gains.tuned(model)
    forward = np.zeros((T, J)) if feedforward is None else feedforward
    noise = encoder_std * rng.normal(size=(T, J))
    low, high = model.actuator_ctrlrange.T
    log = {
        name: np.empty((T, J)) for name in ("position", "velocity", "encoder", "force", "feedback")
    }
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q_r[0], dq_r[0]
    share = 1.0 - np.exp(-2.0 * np.pi * CUTOFF_HZ * dt)
    before, rate, done = -noise[0], np.zeros(J), T
    for k in range(T):
        sensed = data.qpos + noise[k]
        error = q_r[k] - sensed
        rate += share * ((error - before) / dt - rate)
        before = error
        back = gains.position * error + gains.velocity * rate
        tau = np.clip(forward[k] + back, low, high)
        for name, value in zip(log, (data.qpos, data.qvel, sensed, tau, back), strict=True):
            log[name][k] = value
        if np.abs(data.qpos - q_r[k]).max() > SAFE:
            done = k + 1
            break
        data.ctrl[:] = tau
        mujoco.mj_step(model, data, substeps)
    made = {name: values[:done] for name, values in log.items()}
    return Followed(time[:done], q_r[:done], **made, stopped=done < T)


def _inertia_at_joints(model: mujoco.MjModel) -> Float[np.ndarray, " J"]:
    """Mean of the inertia matrix's diagonal over postures [kg m^2 or kg]."""
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    inertia, column = np.zeros(model.nv), np.empty(model.nv)
    for _ in range(POSTURES):
        data.qpos[:] = rng.uniform(*model.jnt_range.T)
        mujoco.mj_forward(model, data)
        for j, unit in enumerate(np.eye(model.nv)):
            mujoco.mj_mulM(model, data, column, unit)
            inertia[j] += column[j] / POSTURES
    return inertia


def control_times(
    model: mujoco.MjModel, seconds: float, substeps: int = 2
) -> Float[np.ndarray, " T"]:
    """When the controller acts [s]."""
    dt = substeps * model.opt.timestep
    return dt * np.arange(round(seconds / dt))


FORCE_NOISE = 0.05
"""standard deviation of a force sensor's noise, relative to that of the force [-]"""


def record_sinusoids(
    model: mujoco.MjModel,
    rng: np.random.Generator,
    *,
    seconds: float = 30.0,
    encoder_std: float = 2e-4,
    force_noise: float = FORCE_NOISE,
    name: str = "sinusoids",
) -> Recording:
    """A recording of random sinusoids under PD feedback alone: nothing of the robot is known yet.

    Its columns are `<joint>_position`, `<joint>_torque` and `<joint>_reference`, a row a step of
    the controller.

    The noise of encoders is in [rad or m], that of force sensors relative to the force [-].

    Reference: Ting et al., sections IV-B and IV-C, whose robots are controlled at 420 and 480 Hz.
    """
    motion = random_sinusoids(model, rng)
    return measured(
        model, follow(model, motion, seconds, rng, encoder_std=encoder_std), rng, force_noise, name
    )


def measured(
    model: mujoco.MjModel,
    followed: Followed,
    rng: np.random.Generator,
    force_noise: float = FORCE_NOISE,
    name: str = "sinusoids",
) -> Recording:
    """A recording of a motion by sensors; the arguments are those of `record_sinusoids`."""
    force = followed.force
    noisy = force + force_noise * force.std(axis=0) * rng.normal(size=force.shape)
    joints = [model.joint(j).name for j in range(model.njnt)]
    return Recording(
        name=name,
        time=followed.time,
        states=np.concatenate([followed.encoder, followed.reference], axis=1),
        inputs=noisy,
        state_names=(*(f"{j}_position" for j in joints), *(f"{j}_reference" for j in joints)),
        input_names=tuple(f"{j}_torque" for j in joints),
        angles=tuple(range(2 * len(joints))),
    )
