"""Laws of the robots: their motions, their control, and what their sensors log."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from envs.arms import ARMS, control_times, follow, load, random_sinusoids, record_sinusoids
from envs.arms.motions import random_motion
from envs.arms.robots import SAFE, scara, ur10
from mcpilco.bodies import Chain, generalised_forces, mass_matrix
from mcpilco.identification import RigidBody, check_links, random_motions
from mcpilco.typing import InputError

TERMS = ("viscous", "coulomb")


def tracked(name: str, feedforward: bool, wrong: float = 0.0):
    """The head or the arm, following sinusoids for a second and a half."""
    model, rng = load(name), np.random.default_rng(2)
    motion, body = random_sinusoids(model, rng), RigidBody.of(load(name), TERMS)
    at = motion.at(control_times(model, 1.5))
    forces = body.regressor(*at) @ body.nominal + wrong if feedforward else None
    return follow(model, motion, 1.5, rng, feedforward=forces)


def rms(followed) -> float:
    return float(np.sqrt(((followed.position - followed.reference) ** 2).mean()))


@pytest.mark.parametrize(("name", "joints"), [("vision_head", 7), ("arm_hand", 10)])
def test_robots_are_made_of_bodies_that_can_exist(name, joints):
    model = load(name)
    body = RigidBody.of(model, TERMS)
    assert len(body.chain.bodies) == joints
    assert all(link.consistent for link in check_links(body, body.nominal))
    assert (model.dof_frictionloss > 0.0).all()
    assert set(ARMS) == {"vision_head", "arm_hand"}


@pytest.mark.parametrize("name", ["vision_head", "arm_hand"])
def test_forces_of_the_regressor_are_mujocos(name):
    """Without dry friction, contacts and end stops, of which MuJoCo makes constraints."""
    model, rng = load(name), np.random.default_rng(0)
    model.dof_frictionloss[:] = 0.0
    model.jnt_limited[:] = 0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    body, data = RigidBody.of(model, ("viscous", "armature")), mujoco.MjData(model)
    motion = random_motions(body, 50, rng)
    expected = []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(*motion, strict=True):
        mujoco.mj_inverse(model, data)
        expected.append(data.qfrc_inverse.copy())
    found = body.regressor(*motion) @ body.nominal
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_an_unknown_robot_is_told_which_there_are():
    with pytest.raises(InputError, match="arm_hand, vision_head, got 'leg'"):
        load("leg")


def test_velocities_and_accelerations_are_derivatives_and_all_stays_within_range():
    model = load("arm_hand")
    motion = random_sinusoids(model, np.random.default_rng(0))
    time, h = np.linspace(0.05, 5.0, 300), 1e-5
    q, dq, ddq = motion.at(time)
    (before, rate_before, _), (after, rate_after, _) = motion.at(time - h), motion.at(time + h)
    np.testing.assert_allclose((after - before) / (2 * h), dq, atol=1e-6)
    np.testing.assert_allclose((rate_after - rate_before) / (2 * h), ddq, atol=1e-5)
    low, high = model.jnt_range.T
    assert (q >= low).all()
    assert (q <= high).all()
    still = motion.at(np.zeros(1))
    np.testing.assert_array_equal(np.concatenate(still[1:]), 0.0)


@pytest.mark.parametrize("name", ["vision_head", "arm_hand"])
def test_the_true_forces_leave_next_to_nothing_to_the_feedback(name):
    exact, blind = tracked(name, True), tracked(name, False)
    assert rms(exact) < 1.5e-3
    assert rms(exact) < 0.03 * rms(blind)
    assert not exact.stopped
    assert (exact.feedback**2).mean() < 0.01 * (blind.feedback**2).mean()


def test_a_robot_that_leaves_its_reference_is_stopped():
    followed = tracked("vision_head", True, wrong=1e3)  # the motors' limits hold
    assert followed.stopped
    assert len(followed.time) < len(control_times(load("vision_head"), 1.5))
    off = np.abs(followed.position - followed.reference).max(axis=1)
    assert off[-1] > SAFE >= off[:-1].max()
    limit = load("vision_head").actuator_ctrlrange[:, 1]
    assert (np.abs(followed.force) <= limit).all()


def test_a_recording_has_the_noise_that_was_asked_for_and_equal_seeds_are_equal():
    model = load("vision_head")
    first, again = (
        record_sinusoids(model, np.random.default_rng(1), seconds=2.0, encoder_std=1e-3)
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.states, again.states)
    np.testing.assert_array_equal(first.inputs, again.inputs)
    assert first.state_names[0] == "neck_pitch_position"
    assert first.state_names[7] == "neck_pitch_reference"
    assert first.input_names[6] == "right_eye_tilt_torque"
    jerky = np.diff(first.states[:, :7], n=3, axis=0)  # of white noise: 20 times its variance
    np.testing.assert_allclose(jerky.std(axis=0) / np.sqrt(20.0), 1e-3, rtol=0.1)


def test_the_models_are_loaded_by_plain_mujoco():
    for path in ARMS.values():
        assert mujoco.MjModel.from_xml_path(str(path)).nu in (7, 10)


CHAINS = {"scara": scara, "ur10": ur10}


@pytest.fixture(params=CHAINS)
def arm(request) -> Chain:
    return CHAINS[request.param]()


def test_inertia_of_an_arm_is_symmetric_and_positive_definite(arm):
    q, _, _ = random_motion(arm, np.random.default_rng(0), 20)
    M = mass_matrix(arm, q)
    np.testing.assert_allclose(M, M.mT, atol=1e-12)
    assert np.linalg.eigvalsh(M).min() > 0.0


def test_kinds_of_joints():
    assert [body.kind for body in scara().bodies] == ["hinge", "hinge", "slide", "hinge"]
    assert [body.kind for body in ur10().bodies] == ["hinge"] * 6


def test_the_quill_of_a_scara_carries_its_weight_and_no_other_joint_does():
    still = np.zeros((1, 4))
    tau = generalised_forces(scara(), np.ones((1, 4)), still, still)
    np.testing.assert_allclose(tau, [[0.0, 0.0, -4.0 * 9.81, 0.0]], atol=1e-12)


def test_a_stretched_ur10_reaches_as_far_as_its_links():
    bodies = ur10().bodies
    lengths = [np.linalg.norm(body.origin) for body in bodies]
    np.testing.assert_allclose(lengths, [0.0, 0.1273, 0.612, 0.5723, 0.163941, 0.1157])


def test_motions_are_derivatives_of_one_another(arm):
    dt = 1e-3
    q, dq, ddq = random_motion(arm, np.random.default_rng(1), 200, dt)
    for value, slope in ((q, dq), (dq, ddq)):
        differences = (value[2:] - value[:-2]) / (2 * dt)
        np.testing.assert_allclose(differences, slope[1:-1], atol=1e-4 * np.abs(slope).max())
