"""Recordings of arms whose chains the tests know."""

from __future__ import annotations

import numpy as np

from envs.arms.marked import IDEAL, Camera, MarkedArm, random_marked_arm
from envs.arms.motions import sinusoids
from mcpilco.identification.kinematics import KinematicChain
from mcpilco.recordings import MarkerRecording, marker_recording


def recorded(
    seed: int, joints: int = 5, samples: int = 50, camera: Camera = IDEAL
) -> tuple[MarkedArm, MarkerRecording]:
    """A random arm, and what a camera saw of a random motion."""
    rng = np.random.default_rng(seed)
    arm = random_marked_arm(rng, joints)
    time = 0.1 * np.arange(samples)
    q = sinusoids(time, arm.kinds, rng)
    return arm, marker_recording(arm.log(time, q, camera, rng))


def is_true(chain: KinematicChain, arm: MarkedArm) -> bool:
    found = [(joint.name, joint.kind) for joint in chain.joints]
    return chain.markers == arm.markers and found == list(zip(arm.joints, arm.kinds, strict=True))
