"""Laws of the arm that sticks: what its currents are while it moves, rests and is pushed."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from envs.arms.motions import waypoints
from envs.arms.sticky_arm import MODEL, PID, SAMPLING_S, Drives, Push, StickyArm
from mcpilco.mjcf import chain_of
from mcpilco.typing import InputError

QUIET = Drives(position_noise=0.0, velocity_noise=0.0, current_noise=0.0)


@pytest.fixture(scope="module")
def arm() -> StickyArm:
    return StickyArm.drawn(np.random.default_rng(0), QUIET)


@pytest.fixture(scope="module")
def targets():
    return waypoints(6, np.random.default_rng(1), rest_s=(1.0, 1.0), always=0)


def resting(log, targets) -> np.ndarray:
    """Samples of the last half of each rest."""
    found = np.zeros(len(log.time), dtype=bool)
    for move in targets.moves:
        found |= (log.time > move.end_s + 0.5) & (log.time < move.end_s + move.rest_s)
    return found


def test_its_model_is_a_chain_and_the_drawn_arm_another(arm):
    owner = chain_of(mujoco.MjModel.from_xml_path(str(MODEL)))
    true = chain_of(arm.model)
    assert owner.joints == true.joints == arm.joints
    ratio = [t.mass / o.mass for t, o in zip(true.bodies, owner.bodies, strict=True)]
    assert 0.8 <= min(ratio) < 0.97
    assert 1.03 < max(ratio) <= 1.2
    assert [b.origin for b in owner.bodies] == [b.origin for b in true.bodies]


def test_it_follows_its_targets_and_stands_still_between_them(arm, targets):
    log = arm.follow(targets, np.random.default_rng(2))
    assert np.abs(log.position - log.target_position).max() < 0.02
    still = resting(log, targets)
    assert still.sum() > 200
    assert np.abs(log.velocity[still]).max() < 1e-3


def test_the_current_of_an_upright_axis_at_rest_is_what_friction_holds(arm, targets):
    """Gravity has no moment about it, so that a frictionless joint would need none: figure 4.1."""
    log = arm.follow(targets, np.random.default_rng(2))
    current = log.current[resting(log, targets), 0] * arm.drives.torque_per_current[0]
    limit = arm.model.dof_frictionloss[0]
    assert 0.5 * limit < np.abs(current).max() < 1.01 * limit
    assert current.min() < 0.0 < current.max()


def test_currents_at_rest_are_feed_forward_and_feedback(arm, targets):
    log, drives = arm.follow(targets, np.random.default_rng(2)), arm.drives
    torque = drives.stiffness * (log.target_position - log.position)
    torque += drives.damping * (log.target_velocity - log.velocity)
    expected = log.target_current + torque / drives.torque_per_current
    np.testing.assert_allclose(log.current, expected, atol=1e-9)


def test_pid_tells_its_whole_command(targets):
    drives = dataclasses.replace(PID, position_noise=0.0, velocity_noise=0.0, current_noise=0.0)
    arm = StickyArm.drawn(np.random.default_rng(0), drives)
    log = arm.follow(targets, np.random.default_rng(2))
    np.testing.assert_array_equal(log.current, log.target_current)


def test_a_push_that_stiction_holds_leaves_no_trace(arm):
    """From a rest without load: then nothing that is measured can tell it."""
    targets = waypoints(1, np.random.default_rng(1), rest_s=(2.0, 2.0))
    start = targets.q[targets.lead]
    still = dataclasses.replace(
        targets, q=np.tile(start, (600, 1)), dq=np.zeros((600, 6)), ddq=np.zeros((600, 6)), lead=0
    )
    free = arm.follow(still, np.random.default_rng(0))
    limit = arm.model.dof_frictionloss[0]
    weak, strong = (
        arm.follow(still, np.random.default_rng(0), [Push(0.4, share * limit)])
        for share in (0.5, 1.5)
    )
    tip = 1e-4  # the regularised friction gives by so much
    assert np.abs(weak.position - free.position)[:, 0].max() < tip
    assert np.abs(strong.position - free.position)[:, 0].max() > 5 * tip


def test_a_push_has_its_torque_about_the_first_joint(arm, targets):
    log = arm.follow(targets, np.random.default_rng(2), [Push(2.0, 30.0), Push(4.0, -10.0)])
    since = log.time[:, None] - (2.0, 4.0)
    at = ((since >= 0.0) & (since <= Push(2.0, 30.0).duration_s)).any(axis=1)
    assert 0.7 < at.sum() * SAMPLING_S < 0.9
    assert not log.force[~at].any()
    data, site = mujoco.MjData(arm.model), arm.model.site("tool").id
    k = int(2.2 / SAMPLING_S)
    data.qpos[:] = log.position[k]
    mujoco.mj_kinematics(arm.model, data)
    moment = np.cross(data.site_xpos[site], log.force[k])
    assert moment[2] == pytest.approx(30.0, rel=0.01)
    assert log.force[k, 2] == 0.0


def test_equal_seeds_give_equal_logs(targets):
    logs = [
        StickyArm.drawn(np.random.default_rng(5)).follow(targets, np.random.default_rng(6))
        for _ in range(2)
    ]
    np.testing.assert_array_equal(logs[0].current, logs[1].current)


def test_targets_are_smooth_and_within_reach(targets):
    np.testing.assert_allclose(np.diff(targets.q, axis=0) / targets.dt, targets.dq[:-1], atol=0.02)
    np.testing.assert_allclose(np.diff(targets.dq, axis=0) / targets.dt, targets.ddq[:-1], atol=0.3)


def test_targets_of_another_sampling_time_are_refused(arm):
    with pytest.raises(InputError, match="every 0.002 s, got 0.01 s"):
        arm.follow(waypoints(1, np.random.default_rng(0), dt=0.01), np.random.default_rng(0))
