"""A robot under computed torque: the inverse dynamics of the reference, and PD feedback.

    tau = tau_ff(q_r, q_r', q_r'') + K_p (q_r - q) + K_d (q_r' - q')

q comes from encoders with noise, and q_r' - q' from a low-pass filter of the differences of
q_r - q. The forces of the model depend on the reference alone: they are found beforehand, with any
model.

Reference: An, Atkeson, Hollerbach, Model-based control of a robot manipulator, 1988, chapter 6
    (feedforward control); Ting et al., section IV-B.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from envs.arms.sinusoids import Sinusoids

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

    Args:
        model: of the robot.
        reference: what to follow.
        seconds: for how long [s].
        rng: of the encoders' noise.
        feedforward: forces at the controller's steps [N m or N]; none by default.
        gains: of the feedback; by default `Gains.tuned`.
        encoder_std: standard deviation of the encoders' white noise [rad or m].
        substeps: timesteps of the model that a command is held for.
    """
    time = control_times(model, seconds, substeps)
    T, J, dt = len(time), model.nv, substeps * model.opt.timestep
    q_r, dq_r, _ = reference.at(time)
    gains = gains or Gains.tuned(model)
    forward = np.zeros((T, J)) if feedforward is None else feedforward
    noise = encoder_std * rng.normal(size=(T, J))
    low, high = model.actuator_ctrlrange.T
    log = {name: np.empty((T, J)) for name in ("q", "dq", "sensed", "tau", "back")}
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
    return Followed(
        time=time[:done],
        reference=q_r[:done],
        position=log["q"][:done],
        velocity=log["dq"][:done],
        encoder=log["sensed"][:done],
        force=log["tau"][:done],
        feedback=log["back"][:done],
        stopped=done < T,
    )


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
