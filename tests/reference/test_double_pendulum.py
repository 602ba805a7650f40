"""Laws of the double pendulum's equations of motion."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.reference.double_pendulum import (
    AcrobotDynamics,
    DoublePendulumDynamics,
    PendubotDynamics,
)

OTHER = {
    "upper_mass": 0.7,
    "upper_length": 0.4,
    "lower_mass": 0.5,
    "lower_length": 0.25,
    "shoulder_friction": 0.02,
    "elbow_friction": 0.05,
    "gravity": 3.7,
    "upper_center": 0.6,
    "upper_inertia": 0.2,
    "lower_center": 0.4,
    "lower_inertia": 0.3,
}
EACH = pytest.mark.parametrize(
    "dynamics",
    [
        PendubotDynamics.nominal(),
        AcrobotDynamics.nominal(),
        PendubotDynamics.nominal(**OTHER),
        AcrobotDynamics.nominal(**OTHER),
    ],
    ids=["pendubot", "acrobot", "other-pendubot", "other-acrobot"],
)


def some_states(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.normal(size=(n, 4)) * [3.0, 5.0, 3.0, 5.0], rng.uniform(-6, 6, n)


def in_mujoco(dynamics: DoublePendulumDynamics) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The same system; inertias across the plane of motion, which no motion in it feels, are 1."""

    def inertial(mass: float, length: float, center: float, inertia: float) -> str:
        about = inertia * mass * length**2
        return (
            f'<inertial pos="0 0 {-center * length}" mass="{mass}" diaginertia="{about} {about} '
            f'{about}"/>'
        )

    d = dynamics
    model = mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <compiler angle="radian"/>
      <option gravity="0 0 {-d.gravity}" timestep="1e-4" integrator="RK4"/>
      <worldbody>
        <body>
          <joint axis="0 -1 0" damping="{d.shoulder_friction}"/>
          {inertial(d.upper_mass, d.upper_length, d.upper_center, d.upper_inertia)}
          <body pos="0 0 {-d.upper_length}">
            <joint axis="0 -1 0" damping="{d.elbow_friction}"/>
            {inertial(d.lower_mass, d.lower_length, d.lower_center, d.lower_inertia)}
          </body>
        </body>
      </worldbody>
    </mujoco>
    """)
    return model, mujoco.MjData(model)


@EACH
def test_motion_is_that_of_mujoco(dynamics):
    model, data = in_mujoco(dynamics)
    start, torque = np.array([1.0, 2.0, -0.5, 3.0]), 1.7
    data.qpos[:], data.qvel[:] = start[0::2], start[1::2]
    data.qfrc_applied[dynamics.motor] = torque
    path = dynamics.advance(start, torque, 0.2, samples=4)
    for state in path:
        for _ in range(500):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(data.qpos, state[0::2], rtol=0, atol=1e-9)
        np.testing.assert_allclose(data.qvel, state[1::2], rtol=0, atol=1e-8)


@EACH
def test_random_torque_for_2_s_agrees_with_an_adaptive_integrator(dynamics):
    """Errors of either grow with the motion, for it is chaotic."""
    rng = np.random.default_rng(3)
    ours = theirs = np.array([0.3, -0.2, 0.1, 0.4])
    for u in rng.uniform(-2.0, 2.0, 40):
        ours = dynamics.advance(ours, u, 0.05)[-1]
        solution = solve_ivp(
            lambda t, x, u=u: dynamics.derivative(x, u),
            (0.0, 0.05),
            theirs,
            method="DOP853",
            rtol=1e-12,
            atol=1e-12,
        )
        theirs = solution.y[:, -1]
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-7)


@pytest.mark.parametrize("kind", [PendubotDynamics, AcrobotDynamics])
def test_energy_is_conserved_without_friction_and_torque(kind):
    dynamics = kind.nominal(shoulder_friction=0.0, elbow_friction=0.0)
    states, _ = some_states(8)
    path = dynamics.advance(states, np.zeros(8), 1.0, samples=20)
    energy = np.broadcast_to(dynamics.energy(states), (20, 8))
    np.testing.assert_allclose(dynamics.energy(path), energy, rtol=1e-10, atol=1e-10)


@EACH
def test_energy_changes_by_the_work_of_torque_and_friction(dynamics):
    states, u = some_states(8)
    samples, duration = 4000, 0.25
    path = np.concatenate([states[None], dynamics.advance(states, u, duration, samples)])
    speeds = path[..., 1::2]
    friction = np.array([dynamics.shoulder_friction, dynamics.elbow_friction])
    power = u * speeds[..., dynamics.motor] - (friction * speeds**2).sum(axis=-1)
    work = np.trapezoid(power, dx=duration / samples, axis=0)
    gained = dynamics.energy(path[-1]) - dynamics.energy(path[0])
    np.testing.assert_allclose(gained, work, rtol=0, atol=1e-3)


def test_motors_are_in_their_joints():
    """A torque in the shoulder turns the upper link forth; one in the elbow turns it back."""
    still = np.zeros(4)
    assert PendubotDynamics.nominal().derivative(still, 1.0)[1] > 0
    assert (
        AcrobotDynamics.nominal().derivative(still, 1.0)[1]
        < 0
        < AcrobotDynamics.nominal().derivative(still, 1.0)[3]
    )


def test_links_hang_at_zero_and_stand_where_the_shoulder_is_at_pi():
    dynamics = PendubotDynamics.nominal()
    states = np.array([[0, 0, 0, 0], [np.pi, 0, 0, 0], [np.pi / 2, 0, np.pi / 2, 0]])
    tips = [[0, 0, -0.5], [0, 0, 0.5], [0.2, 0, 0.3]]
    np.testing.assert_allclose(dynamics.tip(states), tips, atol=1e-15)
    np.testing.assert_allclose(dynamics.derivative(states[:2], 0.0), 0.0, atol=1e-13)


def test_numbers_are_those_that_the_authors_publish():
    """Of design C.1: inertias about the joints, weights and what couples the links, to 1 %."""
    dynamics = PendubotDynamics.nominal()
    masses, about_joints = (0.5234602302310271, 0.6255677234174437), (0.0318871996, 0.0508698481)
    upper = about_joints[0] + masses[1] * 0.2**2
    assert dynamics.inertias == pytest.approx((upper, about_joints[1]), rel=0.01)
    center = masses[1] * 0.25569305436052964
    assert dynamics.coupling == pytest.approx(0.2 * center, rel=0.01)
    assert dynamics.weights == pytest.approx((9.81 * 0.2 * sum(masses), 9.81 * center), rel=0.01)
