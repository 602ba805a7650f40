"""Laws of the regressor: MuJoCo's forces, linear in the parameters, and pinocchio's columns."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mcpilco.bodies import INERTIAL, generalised_forces
from mcpilco.identification import TERMS, motions, rigid_body
from mcpilco.typing import InputError
from tests.mcpilco.identification.arms import arm, arm_body
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
    body = rigid_body(model, terms=("viscous", "armature", "stiffness", "offset"))
    motion = motions(body, 20, rng)
    expected = inverse(model, *motion)
    found = body.regressor(*motion) @ body.nominal
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_dry_friction_is_what_a_fast_joint_feels_of_mujocos():
    model = arm()
    model.dof_frictionloss[:] = np.linspace(0.1, 0.7, 7)
    body = rigid_body(model)
    q, dq, ddq = motions(body, 20, np.random.default_rng(0))
    dry = np.flatnonzero(["coulomb" in name for name in body.names])
    found = body.regressor(q, dq, ddq)[:, :, dry] @ body.nominal[dry]
    np.testing.assert_allclose(found, np.sign(dq) * model.dof_frictionloss, atol=1e-9)


def test_forces_are_linear_in_each_bodys_parameters():
    """Other masses and inertias in the model, and in theta."""
    body = rigid_body(arm())
    model = arm()
    model.body_mass[3] *= 2.0
    model.body_ipos[5] += 0.05
    other = rigid_body(model)
    motion = motions(body, 20, np.random.default_rng(1))
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
    q, dq, ddq = motions(body, 10, np.random.default_rng(2))
    ours = body.regressor(q, dq, ddq).reshape(10, 7, 7, 11)[..., :10]
    # pinocchio's inertias come in the order xx xy yy xz yz zz
    order = [0, 1, 2, 3, 4, 5, 7, 6, 8, 9]
    for n in range(10):
        theirs = pinocchio.computeJointTorqueRegressor(robot, robot_data, q[n], dq[n], ddq[n])
        np.testing.assert_allclose(
            ours[n][..., order], theirs.reshape(7, 7, 10), atol=1e-9 * np.abs(theirs).max()
        )


def test_names_and_units_stand_beside_the_parameters():
    body = rigid_body(arm(), terms=tuple(TERMS))
    assert len(body.names) == len(body.units) == len(body.nominal) == 7 * (10 + len(TERMS))
    told = dict(zip(body.names, zip(body.nominal, body.units, strict=True), strict=True))
    assert told["link2_m"] == (pytest.approx(2.4), "kg")
    assert told["joint2_viscous"] == (pytest.approx(0.7), "N m s/rad")
    assert told["link0_Ixz"][1] == "kg m^2"


def test_without_terms_of_joints_only_bodies_are_left():
    body = rigid_body(arm(), terms=())
    motion = motions(body, 5, np.random.default_rng(3))
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
        rigid_body(arm(), terms=("viscous", "stiction"))
    with pytest.raises(InputError, match="terms must be"):
        rigid_body(arm(), terms=("viscous", "viscous"))
    free = "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    with pytest.raises(InputError, match="free or ball joints"):
        rigid_body(mujoco.MjModel.from_xml_string(free))
    still = "<mujoco><worldbody><geom size='1'/></worldbody></mujoco>"
    with pytest.raises(InputError, match="must have joints"):
        rigid_body(mujoco.MjModel.from_xml_string(still))
