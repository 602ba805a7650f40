"""Laws of the pendulum's equation of motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

from tests.reference.pendulum import PendulumDynamics

OTHER = PendulumDynamics.nominal(mass=1.3, length=0.8, friction=0.7, gravity=3.7)
BOTH = pytest.mark.parametrize(
    "dynamics", [PendulumDynamics.nominal(), OTHER], ids=["default", "other"]
)


def some_states(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.normal(size=(n, 2)) * [3.0, 5.0], rng.uniform(-3, 3, n)


def first_pass(dynamics: PendulumDynamics, angle: float, until: float) -> float:
    """When a pendulum released at rest first hangs straight down, by linear interpolation [s]."""
    steps = 4000
    q = dynamics.advance(np.array([angle, 0.0]), 0.0, until, steps)[:, 0]
    k = int(np.flatnonzero(q <= 0)[0])
    return until / steps * (k + q[k - 1] / (q[k - 1] - q[k]))


@BOTH
def test_acceleration_is_that_of_a_mass_on_a_rod(dynamics):
    states, u = some_states(50)
    angle, speed = states.T
    m, length, b, g = dynamics.mass, dynamics.length, dynamics.friction, dynamics.gravity
    expected = (u - b * speed) / (m * length**2) - g / length * np.sin(angle)
    rates = dynamics.derivative(states, u)
    np.testing.assert_array_equal(rates[:, 0], speed)
    np.testing.assert_allclose(rates[:, 1], expected, rtol=1e-12, atol=1e-12)


def test_energy_is_conserved_without_friction_and_torque():
    dynamics = PendulumDynamics.nominal(friction=0.0)
    states, _ = some_states(20)
    path = dynamics.advance(states, np.zeros(20), 4.0, samples=40)
    energy = np.broadcast_to(dynamics.energy(states), (40, 20))
    np.testing.assert_allclose(dynamics.energy(path), energy, rtol=1e-11)


def test_energy_changes_by_the_work_of_torque_and_friction():
    states, u = some_states(8)
    samples, duration = 4000, 1.0
    path = np.concatenate([states[None], OTHER.advance(states, u, duration, samples)])
    power = (u - OTHER.friction * path[..., 1]) * path[..., 1]
    work = np.trapezoid(power, dx=duration / samples, axis=0)
    np.testing.assert_allclose(OTHER.energy(path[-1]) - OTHER.energy(path[0]), work, atol=1e-4)


@BOTH
def test_random_torque_for_4_s_agrees_with_an_adaptive_integrator(dynamics):
    rng = np.random.default_rng(3)
    ours = theirs = np.array([0.3, -0.2])
    for u in rng.uniform(-1.2, 1.2, 40):
        path = dynamics.advance(ours, u, 0.1, samples=10)
        ours = path[-1]
        solution = solve_ivp(
            lambda t, x, u=u: dynamics.derivative(x, u),
            (0.0, 0.1),
            theirs,
            method="DOP853",
            rtol=1e-12,
            atol=1e-12,
            t_eval=np.arange(1, 11) / 100,
        )
        theirs = solution.y[:, -1]
        np.testing.assert_allclose(path, solution.y.T, rtol=0, atol=1e-9)


@pytest.mark.parametrize("length", [0.2, 0.5, 1.5])
def test_small_swing_has_the_period_of_the_formula(length):
    dynamics = PendulumDynamics.nominal(length=length, friction=0.0)
    period = 2 * np.pi * np.sqrt(length / dynamics.gravity)
    # a swing of 0.01 rad is slower by a share of 0.01^2 / 16
    assert 4 * first_pass(dynamics, 0.01, period) == pytest.approx(period, rel=1e-5)


def test_large_swing_has_the_period_of_the_elliptic_integral():
    dynamics, angle = PendulumDynamics.nominal(friction=0.0), 3.0
    period = 4 * np.sqrt(dynamics.length / dynamics.gravity) * ellipk(np.sin(angle / 2) ** 2)
    assert 4 * first_pass(dynamics, angle, period) == pytest.approx(period, rel=1e-6)


def test_weight_is_the_torque_that_holds_the_rod_level():
    rates = OTHER.derivative(np.array([np.pi / 2, 0.0]), OTHER.weight)
    np.testing.assert_allclose(rates, 0.0, atol=1e-14)
    assert PendulumDynamics.nominal().weight == pytest.approx(2.95, abs=0.005)


def test_mass_hangs_below_the_hinge_and_stands_on_the_target():
    tip = OTHER.tip(np.array([[0.0, 0], [np.pi, 0], [np.pi / 2, 0]]))
    np.testing.assert_allclose(tip, [[0, 0, -0.8], [0, 0, 0.8], [0.8, 0, 0]], atol=1e-15)
