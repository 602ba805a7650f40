"""Laws of base parameters: as many as theory counts, and forces depend on nothing else."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mcpilco.identification import base_parameters, motions, rigid_body
from tests.mcpilco.identification.arms import arm
from tests.mcpilco.random_chains import random_mjcf


@pytest.mark.parametrize(("gravity", "count"), [("0 0 -9.81", 43), ("3 2 -9", 45)])
def test_seven_hinges_have_as_many_base_parameters_as_theory_counts(gravity, count):
    """7 J - 4 where the first axis is not upright, two less where it is.

    Reference: Gautier, Khalil, IEEE Transactions on Robotics and Automation 6 (3), 1990.
    """
    body = rigid_body(arm(gravity), terms=())
    Y = body.regressor(*motions(body, 100, np.random.default_rng(0)))
    assert len(base_parameters(Y)) == count


@pytest.mark.parametrize("seed", range(8))
def test_forces_depend_on_base_parameters_alone(seed):
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(random_mjcf(rng, 1 + seed % 5))
    body = rigid_body(model)
    Y = body.regressor(*motions(body, 200, rng))
    base = base_parameters(Y)
    columns = Y.reshape(-1, Y.shape[-1])
    lengths = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(lengths > 1e-9, lengths, np.inf)
    assert len(base) == np.linalg.matrix_rank(columns, tol=1e-8)
    fresh = body.regressor(*motions(body, 50, rng))
    theta = rng.normal(size=Y.shape[-1])
    scale = np.abs(fresh @ theta).max()
    np.testing.assert_allclose(
        base.columns(fresh) @ base.of(theta), fresh @ theta, atol=1e-8 * scale
    )
    np.testing.assert_allclose(fresh @ base.lift(base.of(theta)), fresh @ theta, atol=1e-8 * scale)


def test_a_pendulum_tells_its_inertia_about_the_axis_and_its_first_moments():
    pendulum = """<mujoco><worldbody><body name="rod"><joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05"/></body></worldbody></mujoco>"""
    body = rigid_body(mujoco.MjModel.from_xml_string(pendulum))
    base = base_parameters(body.regressor(*motions(body, 100, np.random.default_rng(0))))
    assert base.formulas(body.names) == (
        "rod_mx",
        "rod_mz",
        "rod_Iyy + 1 hinge_armature",
        "hinge_viscous",
        "hinge_coulomb",
    )


def test_what_a_recording_cannot_tell_is_no_base_parameter_of_it():
    """A joint that stands still has no friction to be seen, and its inertia acts on none."""
    body = rigid_body(arm(), terms=("viscous",))
    q, dq, ddq = motions(body, 200, np.random.default_rng(0))
    q[:, 6], dq[:, 6], ddq[:, 6] = 0.3, 0.0, 0.0
    still = base_parameters(body.regressor(q, dq, ddq))
    moving = base_parameters(body.regressor(*motions(body, 200, np.random.default_rng(0))))
    assert len(still) < len(moving)
    told = [body.names[k] for k in still.independent]
    assert "joint6_viscous" not in told
    assert "joint5_viscous" in told
