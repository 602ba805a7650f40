"""Laws of the regressor of joint forces, and of its base parameters."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mcpilco.bodies import INERTIAL, generalised_forces
from mcpilco.identification import (
    TERMS,
    RigidBody,
    base_parameters,
    check_links,
    from_virtual,
    pseudo_inertia,
    random_motions,
    to_virtual,
)
from mcpilco.identification.rigid_body.body import from_pseudo_inertia
from mcpilco.typing import InputError
from tests.mcpilco.identification.rigid_body.arms import arm, arm_body
from tests.mcpilco.identification.rigid_body.links import random_links
from tests.mcpilco.random_chains import random_mjcf


def inverse(model, q, dq, ddq) -> np.ndarray:
    """MuJoCo's forces (N, J)."""
    data, found = mujoco.MjData(model), np.empty_like(q)
    for n in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[n], dq[n], ddq[n]
        mujoco.mj_inverse(model, data)
        found[n] = data.qfrc_inverse
    return found


@pytest.mark.parametrize("seed", range(20))
def test_forces_of_random_chains_are_mujocos(seed):
    rng = np.random.default_rng(seed)
    joints = 1 + seed % 7
    model = mujoco.MjModel.from_xml_string(random_mjcf(rng, joints))
    model.dof_damping[:] = rng.uniform(0.0, 2.0, joints)
    model.jnt_stiffness[:] = rng.uniform(0.0, 2.0, joints)
    model.qpos_spring[:] = rng.normal(size=joints)
    body = RigidBody.of(model, terms=("viscous", "armature", "stiffness", "offset"))
    motion = random_motions(body, 20, rng)
    expected = inverse(model, *motion)
    found = body.regressor(*motion) @ body.nominal
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_dry_friction_is_what_a_fast_joint_feels_of_mujocos():
    model = arm()
    model.dof_frictionloss[:] = np.linspace(0.1, 0.7, 7)
    body = RigidBody.of(model)
    q, dq, ddq = random_motions(body, 20, np.random.default_rng(0))
    dry = np.flatnonzero(["coulomb" in name for name in body.names])
    found = body.regressor(q, dq, ddq)[:, :, dry] @ body.nominal[dry]
    np.testing.assert_allclose(found, np.sign(dq) * model.dof_frictionloss, atol=1e-9)


def test_forces_are_linear_in_each_bodys_parameters():
    """Other masses and inertias in the model, and in theta."""
    body = RigidBody.of(arm())
    model = arm()
    model.body_mass[3] *= 2.0
    model.body_ipos[5] += 0.05
    other = RigidBody.of(model)
    motion = random_motions(body, 20, np.random.default_rng(1))
    found = body.regressor(*motion) @ other.nominal
    np.testing.assert_allclose(found, inverse(model, *motion), atol=1e-9)
    changed = {body.names[k] for k in np.flatnonzero(body.nominal != other.nominal)}
    assert changed == {
        *(f"link2_{symbol}" for symbol in INERTIAL),
        *(f"link4_{symbol}" for symbol in INERTIAL[1:]),
    }


def test_pinocchio_finds_the_same_columns(tmp_path):
    pinocchio = pytest.importorskip("pinocchio")
    path = tmp_path / "arm.xml"
    mujoco.mj_saveLastXML(str(path), arm())
    robot = pinocchio.buildModelFromMJCF(str(path))
    robot_data = robot.createData()
    body = arm_body()
    q, dq, ddq = random_motions(body, 10, np.random.default_rng(2))
    ours = body.regressor(q, dq, ddq).reshape(10, 7, 7, 11)[..., :10]
    # pinocchio's inertias come in the order xx xy yy xz yz zz
    order = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]
    for n in range(10):
        theirs = pinocchio.computeJointTorqueRegressor(robot, robot_data, q[n], dq[n], ddq[n])
        np.testing.assert_allclose(
            ours[n][..., order], theirs.reshape(7, 7, 10), atol=1e-9 * np.abs(theirs).max()
        )


def test_names_and_units_stand_beside_the_parameters():
    body = RigidBody.of(arm(), terms=tuple(TERMS))
    assert len(body.names) == len(body.units) == len(body.nominal) == 7 * (10 + len(TERMS))
    told = dict(zip(body.names, zip(body.nominal, body.units, strict=True), strict=True))
    assert told["link2_m"] == (pytest.approx(2.4), "kg")
    assert told["joint2_viscous"] == (pytest.approx(0.7), "N m s/rad")
    assert told["link0_Ixz"][1] == "kg m^2"


def test_without_terms_of_joints_only_bodies_are_left():
    body = RigidBody.of(arm(), terms=())
    motion = random_motions(body, 5, np.random.default_rng(3))
    found = body.regressor(*motion) @ body.nominal
    np.testing.assert_allclose(found, generalised_forces(body.chain, *motion), atol=1e-9)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    ("motion", "said"),
    [
        ((np.zeros((3, 7)), np.zeros((3, 7)), np.zeros((2, 7))), "ddq must hold"),
        ((np.zeros((3, 6)),) * 3, "q must hold"),
        ((np.zeros((3, 7)), np.full((3, 7), np.nan), np.zeros((3, 7))), "dq must hold"),
    ],
)
def test_what_is_no_motion_is_refused(motion, said):
    with pytest.raises(InputError, match=said):
        arm_body().regressor(*motion)


def test_what_is_no_chain_or_no_term_is_refused():
    with pytest.raises(InputError, match="terms must be some of viscous"):
        RigidBody.of(arm(), terms=("viscous", "stiction"))
    with pytest.raises(InputError, match="terms must be"):
        RigidBody.of(arm(), terms=("viscous", "viscous"))
    free = "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    with pytest.raises(InputError, match="free or ball joints"):
        RigidBody.of(mujoco.MjModel.from_xml_string(free))
    still = "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"
    with pytest.raises(InputError, match="must have joints"):
        RigidBody.of(mujoco.MjModel.from_xml_string(still))


@pytest.mark.parametrize(("gravity", "count"), [("0 0 -9.81", 43), ("3 2 -9", 45)])
def test_seven_hinges_have_as_many_base_parameters_as_theory_counts(gravity, count):
    """7 J - 4 where the first axis is not upright, two less where it is.

    Reference: Gautier, Khalil, IEEE Transactions on Robotics and Automation 6 (3), 1990.
    """
    body = RigidBody.of(arm(gravity), terms=())
    Y = body.regressor(*random_motions(body, 100, np.random.default_rng(0)))
    assert len(base_parameters(Y)) == count


@pytest.mark.parametrize("seed", range(8))
def test_forces_depend_on_base_parameters_alone(seed):
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(random_mjcf(rng, 1 + seed % 5))
    body = RigidBody.of(model)
    Y = body.regressor(*random_motions(body, 200, rng))
    base = base_parameters(Y)
    columns = Y.reshape(-1, Y.shape[-1])
    lengths = np.linalg.norm(columns, axis=0)
    columns = columns / np.where(lengths > 1e-9, lengths, np.inf)
    assert len(base) == np.linalg.matrix_rank(columns, tol=1e-8)
    fresh = body.regressor(*random_motions(body, 50, rng))
    theta = rng.normal(size=Y.shape[-1])
    scale = np.abs(fresh @ theta).max()
    np.testing.assert_allclose(
        base.columns(fresh) @ base.of(theta), fresh @ theta, atol=1e-8 * scale
    )
    np.testing.assert_allclose(
        fresh @ base.near(base.of(theta), 0.0 * theta), fresh @ theta, atol=1e-8 * scale
    )


def test_a_pendulum_tells_its_inertia_about_the_axis_and_its_first_moments():
    pendulum = """<mujoco><worldbody><body name="rod"><joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -1" size="0.05"/></body></worldbody></mujoco>"""
    body = RigidBody.of(mujoco.MjModel.from_xml_string(pendulum))
    base = base_parameters(body.regressor(*random_motions(body, 100, np.random.default_rng(0))))
    assert base.formulas(body.names) == (
        "rod_mx",
        "rod_mz",
        "rod_Iyy + 1 hinge_armature",
        "hinge_viscous",
        "hinge_coulomb",
    )


def test_what_a_recording_cannot_tell_is_no_base_parameter_of_it():
    """A joint that stands still has no friction to be seen, and its inertia acts on none."""
    body = RigidBody.of(arm(), terms=("viscous",))
    q, dq, ddq = random_motions(body, 200, np.random.default_rng(0))
    q[:, 6], dq[:, 6], ddq[:, 6] = 0.3, 0.0, 0.0
    still = base_parameters(body.regressor(q, dq, ddq))
    moving = base_parameters(body.regressor(*random_motions(body, 200, np.random.default_rng(0))))
    assert len(still) < len(moving)
    told = [body.names[k] for k in still.independent]
    assert "joint6_viscous" not in told
    assert "joint5_viscous" in told


def test_a_pseudo_inertia_is_the_second_moment_of_masses():
    rng = np.random.default_rng(0)
    points, masses = rng.normal(size=(5, 3)), rng.uniform(0.1, 1.0, 5)
    raised = np.column_stack([points, np.ones(5)])
    J = np.einsum("p,pi,pj->ij", masses, raised, raised)
    inertia = sum(
        m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(masses, points, strict=True)
    )
    theta = np.concatenate([[masses.sum()], masses @ points, inertia[np.triu_indices(3)]])
    np.testing.assert_allclose(pseudo_inertia(theta), J, atol=1e-14)
    np.testing.assert_allclose(from_pseudo_inertia(J), theta, atol=1e-14)


def test_virtual_parameters_are_those_of_the_printed_equation():
    """Eq. (5) written out, with the names of the seed."""
    v = np.random.default_rng(1).normal(size=(20, 10))
    m = v[:, 0] ** 2
    printed = [
        m,
        *(v[:, k] * m for k in (1, 2, 3)),
        v[:, 4] ** 2 + (v[:, 3] ** 2 + v[:, 2] ** 2) * m,
        v[:, 4] * v[:, 5] - v[:, 1] * v[:, 2] * m,
        v[:, 4] * v[:, 6] - v[:, 1] * v[:, 3] * m,
        v[:, 5] ** 2 + v[:, 7] ** 2 + (v[:, 1] ** 2 + v[:, 3] ** 2) * m,
        v[:, 5] * v[:, 6] + v[:, 7] * v[:, 8] - v[:, 2] * v[:, 3] * m,
        v[:, 6] ** 2 + v[:, 8] ** 2 + v[:, 9] ** 2 + (v[:, 1] ** 2 + v[:, 2] ** 2) * m,
    ]
    np.testing.assert_allclose(from_virtual(v), np.stack(printed, axis=1), atol=1e-12)


def test_virtual_parameters_are_found_again():
    v = np.random.default_rng(2).uniform(0.5, 1.5, (20, 10))
    np.testing.assert_allclose(to_virtual(from_virtual(v)), v, rtol=1e-9)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({0: -0.2}, "mass -0.2 kg is not positive"),
        ({4: -0.5}, "one is negative"),
        ({9: 9.0}, "the largest exceeds the sum of the others"),
        ({10: -0.3}, "viscous -0.3 is negative"),
    ],
)
def test_what_is_wrong_is_said_link_by_link(changes, said):
    body = random_links(np.random.default_rng(0), 3)
    theta = body.nominal.copy()
    for place, value in changes.items():
        theta[body.width + place] = value
    first, wrong, last = check_links(body, theta)
    assert first.consistent
    assert last.consistent
    assert not wrong.consistent
    assert wrong.name == "link1"
    assert said in str(wrong)


def test_bodies_that_exist_are_consistent():
    body = random_links(np.random.default_rng(5), 10)
    assert all(link.consistent for link in check_links(body, body.nominal))


def test_a_thin_rod_and_a_point_are_bodies():
    body = random_links(np.random.default_rng(0), 2)
    theta = body.nominal.reshape(2, -1).copy()
    theta[0, :10] = [1.0, 0.0, 0.0, 0.5, 1 / 3, 0.0, 0.0, 1 / 3, 0.0, 0.0]
    theta[1, :10] = 0.0
    assert all(link.consistent for link in check_links(body, theta.ravel()))
