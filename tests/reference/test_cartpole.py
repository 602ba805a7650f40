"""Laws of the cart-pole's equations of motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.reference.cartpole import CartPoleDynamics

OTHER = CartPoleDynamics.nominal(
    cart_mass=1.3, pole_mass=0.2, pole_length=0.8, cart_friction=0.7, gravity=3.7
)
BOTH = pytest.mark.parametrize(
    "dynamics", [CartPoleDynamics.nominal(), OTHER], ids=["pilco", "other"]
)


def some_states(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, 4)) * [1.0, 2.0, 3.0, 4.0], rng.uniform(-10, 10, n)


@BOTH
def test_accelerations_are_those_of_the_pilco_package(dynamics):
    states, u = some_states(200)
    _, v, th, w = states.T
    mc, mp, length = dynamics.cart_mass, dynamics.pole_mass, dynamics.pole_length
    b, g, total = dynamics.cart_friction, dynamics.gravity, mc + mp
    sin, cos = np.sin(th), np.cos(th)
    den = 4 * total - 3 * mp * cos**2
    dv = (2 * mp * length * w**2 * sin + 3 * mp * g * sin * cos + 4 * u - 4 * b * v) / den
    dw = (-3 * mp * length * w**2 * sin * cos - 6 * total * g * sin - 6 * (u - b * v) * cos) / (
        length * den
    )
    expected = np.stack([v, dv, w, dw], axis=-1)
    np.testing.assert_allclose(dynamics.derivative(states, u), expected, rtol=1e-12, atol=1e-12)


@BOTH
def test_accelerations_are_those_of_the_lagrangian_of_a_rod(dynamics):
    sympy = pytest.importorskip("sympy")
    t, s, u = sympy.symbols("t s u")
    q1, q2 = sympy.Function("q1")(t), sympy.Function("q2")(t)
    mc, mp, length, b, g = (
        dynamics.cart_mass,
        dynamics.pole_mass,
        dynamics.pole_length,
        dynamics.cart_friction,
        dynamics.gravity,
    )
    # energies of the cart and of every piece ds of the rod, at the distance s from the hinge
    x, z = q1 + s * sympy.sin(q2), -s * sympy.cos(q2)
    piece = (x.diff(t) ** 2 + z.diff(t) ** 2) / 2 - g * z
    L = mc * q1.diff(t) ** 2 / 2 + mp / length * sympy.integrate(
        sympy.expand(piece), (s, 0, length)
    )
    equations = [
        L.diff(q.diff(t)).diff(t) - L.diff(q) - push
        for q, push in ((q1, u - b * q1.diff(t)), (q2, 0))
    ]
    symbols = sympy.symbols("x v th w dv dw")
    values = [q1, q1.diff(t), q2, q2.diff(t), q1.diff(t, 2), q2.diff(t, 2)]
    plain = dict(sorted(zip(values, symbols, strict=True), key=lambda pair: -len(str(pair[0]))))
    residual = sympy.lambdify([*symbols, u], [e.subs(plain) for e in equations])

    states, forces = some_states(50, seed=1)
    rates = dynamics.derivative(states, forces)
    np.testing.assert_allclose(
        residual(*states.T, rates[:, 1], rates[:, 3], forces), 0.0, atol=1e-12
    )


def test_energy_is_conserved_without_friction_and_force():
    dynamics = CartPoleDynamics.nominal(cart_friction=0.0)
    states, _ = some_states(20)
    path = dynamics.advance(states, np.zeros(20), 3.0, samples=30)
    energy = np.broadcast_to(dynamics.energy(states), (30, 20))
    np.testing.assert_allclose(dynamics.energy(path), energy, rtol=1e-11)


def test_energy_changes_by_the_work_of_force_and_friction():
    states, u = some_states(8)
    samples, duration = 2000, 1.0
    path = np.concatenate([states[None], OTHER.advance(states, u, duration, samples)])
    power = (u - OTHER.cart_friction * path[..., 1]) * path[..., 1]
    work = np.trapezoid(power, dx=duration / samples, axis=0)
    np.testing.assert_allclose(OTHER.energy(path[-1]) - OTHER.energy(path[0]), work, atol=1e-4)


def test_random_force_for_3_s_agrees_with_an_adaptive_integrator():
    dynamics, rng = CartPoleDynamics.nominal(), np.random.default_rng(3)
    for _ in range(3):
        ours = theirs = rng.normal(size=4) * [0.5, 0.5, 2.0, 0.5]
        for u in rng.uniform(-10, 10, 30):
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


def test_tip_hangs_below_the_cart_and_stands_on_the_target():
    tip = OTHER.tip(np.array([[0.3, 0, 0, 0], [0, 0, np.pi, 0], [0, 0, np.pi / 2, 0]]))
    np.testing.assert_allclose(tip, [[0.3, 0, -0.8], [0, 0, 0.8], [0.8, 0, 0]], atol=1e-15)
