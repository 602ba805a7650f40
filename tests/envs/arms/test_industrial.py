"""The arms of `envs.arms` are what their docstrings say."""

from __future__ import annotations

import numpy as np
import pytest

from envs.arms.industrial import scara, ur10
from envs.arms.motions import random_motion
from mcpilco.bodies import Chain, generalised_forces, mass_matrix

ARMS = {"scara": scara, "ur10": ur10}


@pytest.fixture(params=ARMS)
def arm(request) -> Chain:
    return ARMS[request.param]()


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
