"""Laws of simulated instruments: the robot has the parameters, the log's gains, and no bias."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import mujoco
import numpy as np
import pytest

from mcpilco.identification import (
    Feedback,
    Recipe,
    RigidBody,
    check_links,
    identify,
    refine,
)
from mcpilco.identification.rigid_body import identified
from mcpilco.identification.rigid_body.robot_model import follow_reference, with_parameters
from mcpilco.recordings import Segment, zero_phase
from mcpilco.typing import InputError
from tests.mcpilco.identification.rigid_body.arms import arm
from tests.mcpilco.identification.rigid_body.log import DT, JOINTS, heavier, model

K_P, K_D = np.array([60.0, 25.0]), np.array([6.0, 2.0])


def reference(seconds: float = 20.0) -> np.ndarray:
    time = DT * np.arange(round(seconds / DT))[:, None]
    fast = 0.5 * np.sin(2.0 * np.pi * np.array([0.9, 1.3]) * time + [0.0, 1.0])
    return fast + 0.4 * np.sin(2.0 * np.pi * np.array([0.37, 0.53]) * time)


def recorded(robot: mujoco.MjModel, noise: float, seed: int = 0) -> Segment:
    """A log of a robot under PD feedback that sees the encoders' noise, held between samples."""
    rng, wanted = np.random.default_rng(seed), reference()
    robot.opt.timestep = DT / 5
    data = mujoco.MjData(robot)
    data.qpos[:] = wanted[0]
    rates = np.gradient(wanted, DT, axis=0)
    q, tau, filtered, before = np.empty_like(wanted), np.empty_like(wanted), np.zeros(2), None
    for k, (target, rate) in enumerate(zip(wanted, rates, strict=True)):
        q[k] = data.qpos + noise * rng.normal(size=2)
        error = target - q[k]
        filtered += 0.3 * ((error - (error if before is None else before)) / DT - filtered)
        before = error
        tau[k] = K_P * error + K_D * filtered
        data.qfrc_applied[:] = tau[k]
        mujoco.mj_step(robot, data, 5)
        assert np.isfinite(rate).all()
    return Segment("log", DT, q, np.full_like(q, np.nan), tau, wanted)


@pytest.mark.parametrize("terms", [("viscous",), ("viscous", "coulomb", "armature", "offset")])
@pytest.mark.parametrize("robot", [model(), arm()])
def test_a_model_has_the_parameters_that_it_is_given(robot, terms):
    body = RigidBody.of(robot, terms)
    theta = 1.3 * body.nominal
    theta.reshape(-1, body.width)[:, 10:] += 0.2
    changed = with_parameters(robot, body, theta)
    np.testing.assert_allclose(RigidBody.of(changed, terms).nominal, theta, atol=1e-7)
    np.testing.assert_array_equal(RigidBody.of(robot, terms).nominal, body.nominal)


def test_the_gains_of_a_log_are_found():
    segment = recorded(heavier(), noise=1e-3)
    unknown, nothing = np.full_like(segment.q, np.nan), np.zeros_like(segment.q)
    motion = zero_phase(segment.q, unknown, segment.tau, DT, 8.0)
    commanded = zero_phase(segment.reference, unknown, nothing, DT, 8.0)
    found = Feedback.of(motion, commanded, JOINTS)
    np.testing.assert_allclose(found.position, K_P, rtol=0.05)
    np.testing.assert_allclose(found.velocity, K_D, rtol=0.15)
    with pytest.raises(InputError, match="0% of the force of joint 'shoulder'"):
        Feedback.of(replace(motion, tau=-motion.tau), commanded, JOINTS)


def test_the_simulated_robot_moves_as_the_recorded_one():
    robot = heavier()
    segment = recorded(heavier(), noise=0.0)
    simulated = follow_reference(robot, segment.reference, DT, Feedback(K_P, K_D))
    off = np.sqrt(((simulated - segment.q) ** 2).mean(axis=0))
    away = np.sqrt(((segment.reference - segment.q) ** 2).mean(axis=0))
    assert (off < 0.15 * away).all()
    with pytest.raises(InputError, match="left its reference after"):
        follow_reference(robot, segment.reference, DT, Feedback(-K_P, K_D))


@pytest.mark.slow
def test_simulated_instruments_have_no_bias_where_least_squares_has():
    segment = recorded(heavier(), noise=4e-3)
    truth = RigidBody.of(heavier(), ("viscous",)).nominal
    errors = {}
    for method in ("OLS", "IDIM-IV"):
        found = identify(
            model(), [segment], Recipe(method), terms=("viscous",), cutoff=20.0, held_out=0.0
        )
        true = found.base.of(truth)
        errors[method] = np.linalg.norm(found.beta - true) / np.linalg.norm(true)
        assert found.report.converged
        assert all(link.consistent for link in check_links(found.body, found.theta))
    assert found.report.iterations > 1
    assert errors["OLS"] > 0.3
    assert errors["IDIM-IV"] < 0.05


def test_instruments_that_go_on_changing_are_told(monkeypatch):
    monkeypatch.setattr(identified, "refine", partial(refine, steps=1, tolerance=0.0))
    part = recorded(heavier(), noise=4e-3)
    report = identify(model(), [part], Recipe("IDIM-IV", "none"), terms=("viscous",)).report
    assert not report.converged
    assert report.iterations == 1
    assert any("IDIM-IV did not converge in 1 iterations" in told for told in report.warnings)


def test_without_a_reference_there_is_nothing_to_simulate():
    segment = replace(recorded(heavier(), noise=0.0), reference=None)
    with pytest.raises(InputError, match="IDIM-IV needs the positions that were commanded"):
        identify(model(), [segment], Recipe("IDIM-IV"))
