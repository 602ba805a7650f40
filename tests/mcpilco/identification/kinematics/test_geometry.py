"""A chain in space moves its markers as the arm does."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from envs.arms.marked import Camera
from mcpilco.identification.kinematics import Tolerance, chain_in_space, find_chain
from mcpilco.mjcf import mjcf_of
from tests.mcpilco.identification.kinematics.robots import recorded

NOISY = Camera(0.002, 0.005, outliers=0.03, missing=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("camera", "how", "position", "angle"),
    [(None, Tolerance(1e-6, 1e-5, 0.0), 1e-5, 1e-5), (NOISY, None, 0.02, 0.02)],
)
@pytest.mark.parametrize("seed", [10, pytest.param(12, marks=pytest.mark.slow)])
def test_bodies_of_the_chain_turn_with_the_markers(seed, camera, how, position, angle) -> None:
    arm, recording = recorded(seed, samples=100, **({} if camera is None else {"camera": camera}))
    found = find_chain(recording, how)
    model = mujoco.MjModel.from_xml_string(mjcf_of(chain_in_space(recording, found), []))
    data, fixed = mujoco.MjData(model), []
    rng = np.random.default_rng(0)
    span = recording.q.min(0), recording.q.max(0)
    order = [recording.joint_names.index(joint.name) for joint in found.joints]
    for _ in range(20):
        q = rng.uniform(*span)[order]
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        places, turns = arm.poses(q[None])
        matrices = turns.as_matrix().reshape(len(arm.markers), 3, 3)
        for k in range(len(q)):  # the marker's place in the body's frame does not change
            R = data.xmat[k + 1].reshape(3, 3)
            cosine = 0.5 * (np.trace(R.T @ matrices[k + 1]) - 1.0)
            assert np.arccos(np.clip(cosine, -1.0, 1.0)) < 3 * angle + 1e-6
            fixed.append(R.T @ (places[0, k + 1] - data.xpos[k + 1]))
    offsets = np.array(fixed).reshape(20, len(found.joints), 3)
    assert offsets.std(axis=0).max() < position
