"""Laws of forward and inverse dynamics, against MuJoCo and against the envs' equations."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from envs.plants import cart_pole, double_pendulum, pendulum
from mcpilco.bodies import Chain, accelerations, generalised_forces, stack
from mcpilco.mjcf import plant_of
from mcpilco.plant import Plant
from tests.mcpilco.random_chains import random_mjcf, random_planar_chain
from tests.reference.cartpole import CartPoleDynamics
from tests.reference.pendulum import PendulumDynamics


def chain_of(plant: Plant) -> Chain:
    return plant.chain


def random_motion(rng, n: int, joints: int) -> list[np.ndarray]:
    """Positions, velocities, and accelerations or forces."""
    return [rng.normal(0, scale, (n, joints)) for scale in (1.5, 2.0, 3.0)]


@pytest.mark.parametrize("seed", range(20))
def test_random_chains_move_as_in_mujoco(seed, tmp_path):
    rng = np.random.default_rng(seed)
    joints = 1 + seed % 7
    path = tmp_path / "chain.xml"
    path.write_text(random_mjcf(rng, joints))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    chain = chain_of(plant_of(path))
    assert model.nv == joints
    q, dq, ddq = random_motion(rng, 5, joints)
    inverse, forward = np.empty_like(q), np.empty_like(q)
    for n in range(len(q)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[n], dq[n], ddq[n]
        mujoco.mj_inverse(model, data)
        inverse[n] = data.qfrc_inverse
        data.qfrc_applied[:] = 10.0 * ddq[n]
        mujoco.mj_forward(model, data)
        forward[n] = data.qacc
    for ours, theirs in (
        (generalised_forces(chain, q, dq, ddq), inverse),
        (accelerations(chain, q, dq, 10.0 * ddq), forward),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("seed", range(6))
def test_forward_and_inverse_dynamics_are_inverses(seed):
    rng = np.random.default_rng(seed)
    chain = random_planar_chain(rng, 1 + seed)
    q, dq, ddq = random_motion(rng, 10, 1 + seed)
    found = accelerations(chain, q, dq, generalised_forces(chain, q, dq, ddq))
    np.testing.assert_allclose(found, ddq, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))  # chains of 1 and 2 joints have forms of their own
def test_a_planar_chain_moves_the_same_in_a_world_turned_out_of_the_plane(seed):
    rng = np.random.default_rng(10 + seed)
    chain = random_planar_chain(rng, 1 + seed % 5)
    turn = Rotation.random(rng=rng).as_matrix()
    bodies = [
        replace(
            body,
            origin=tuple(turn @ body.origin),
            rotation=tuple(map(tuple, turn @ np.array(body.rotation))),
        )
        if body.parent < 0
        else body
        for body in chain.bodies
    ]
    turned = Chain(tuple(bodies), tuple(turn @ chain.gravity))
    assert (stack([chain]).planar[0], stack([turned]).planar[0]) == (1, 0)
    motion = random_motion(rng, 10, len(bodies))
    expected = accelerations(turned, *motion)
    np.testing.assert_allclose(accelerations(chain, *motion), expected, rtol=1e-9, atol=1e-9)


def test_the_cart_pole_is_that_of_the_env():
    values = {"cart_mass": 0.7, "pole_mass": 0.3, "pole_length": 0.6, "gravity": 3.7}
    dynamics = CartPoleDynamics.nominal(**values, cart_friction=0.0)
    q, dq, _ = random_motion(np.random.default_rng(0), 50, 2)
    force = np.linspace(-10, 10, 50)
    tau = np.stack([force, np.zeros(50)], axis=1)
    found = accelerations(chain_of(cart_pole().where(**values)), q, dq, tau)
    expected = dynamics.accelerations(q, dq, force)
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)


def test_the_pendulum_is_that_of_the_env():
    values = {"mass": 1.3, "length": 0.8, "gravity": 3.7}
    dynamics = PendulumDynamics.nominal(**values, friction=0.0)
    q, dq, tau = random_motion(np.random.default_rng(0), 50, 1)
    found = accelerations(chain_of(pendulum().where(**values)), q, dq, tau)
    expected = dynamics.accelerations(q, dq, tau[:, 0])
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-11)


def test_energy_grows_by_the_power_of_the_forces():
    """d/dt (q'.M q' / 2) + g.q' = tau.q', with M and g from inverse dynamics alone."""
    rng = np.random.default_rng(5)
    chain = random_planar_chain(rng, 4)
    q, dq, tau = random_motion(rng, 10, 4)
    ddq, rest, h = accelerations(chain, q, dq, tau), np.zeros_like(q), 1e-5

    def weight(q):
        return generalised_forces(chain, q, rest, rest)

    def kinetic(q, dq):
        return 0.5 * np.sum(dq * (generalised_forces(chain, q, rest, dq) - weight(q)), axis=1)

    after, before = (kinetic(q + s * h * dq, dq + s * h * ddq) for s in (1.0, -1.0))
    gain = (after - before) / (2.0 * h) + np.sum(weight(q) * dq, axis=1)
    np.testing.assert_allclose(gain, np.sum(tau * dq, axis=1), rtol=1e-6, atol=1e-6)


def test_armature_is_felt_at_its_own_joint_only():
    rng = np.random.default_rng(1)
    chain = chain_of(double_pendulum())
    upper, lower = chain.bodies
    geared = Chain((upper, replace(lower, armature=0.3)), chain.gravity)
    q, dq, ddq = random_motion(rng, 10, 2)
    more = generalised_forces(geared, q, dq, ddq) - generalised_forces(chain, q, dq, ddq)
    np.testing.assert_allclose(more, ddq * [0.0, 0.3], atol=1e-12)
    tau = generalised_forces(geared, q, dq, ddq)
    np.testing.assert_allclose(accelerations(geared, q, dq, tau), ddq, rtol=1e-9)
