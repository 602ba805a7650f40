"""Recordings of a robot that follows sinusoids: encoders and force sensors, with noise."""

from __future__ import annotations

import mujoco
import numpy as np

from envs.arms.control import Followed, follow
from envs.arms.sinusoids import random_sinusoids
from mcpilco.recordings import Recording

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

    Args:
        model: of the robot.
        rng: of the motion and of all noise.
        seconds: of data [s].
        encoder_std: standard deviation of the encoders' noise [rad or m].
        force_noise: standard deviation of the force sensors' noise, relative to that of the force.
        name: of the recording.


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
