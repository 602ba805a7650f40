"""A learned force is what its splines say, and nothing away from its grid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import envs
from mcpilco.plant.effects.learned import Axis, LearnedForce, design
from mcpilco.typing import InputError

PENDULUM = envs.PLANTS["mcpilco/Pendulum-v0"]()
M, L, B, G = 0.6, 0.5, 0.05, 9.82
ANGLE = Axis("angle", -2.0, 2.0, 15)
SPEED = Axis("velocity", -8.0, 8.0, 12, slow=0.5)
TORQUE = Axis("torque", -1.5, 1.5, 6)
TURN = Axis("angle", -2.0, -2.0 + 2.0 * np.pi * 8 / 9, 9, closed=True)


def random_force(*axes: Axis) -> LearnedForce:
    size = int(np.prod([axis.knots for axis in axes]))
    weights = np.random.default_rng(0).normal(0.0, 0.5, size)
    return LearnedForce("pendulum", axes, tuple(weights))


@pytest.mark.parametrize(
    "axes",
    [
        (ANGLE,),
        (SPEED,),
        (TORQUE,),
        (TURN,),
        (ANGLE, SPEED),
        (SPEED, TORQUE),
        (SPEED, ANGLE),
        (TURN, SPEED),
        (SPEED, TURN),
    ],
)
def test_a_plant_moves_as_the_force_says(axes: tuple[Axis, ...]) -> None:
    """Beside scipy's integrator with scipy's splines."""
    force, torque = random_force(*axes), 0.7

    def slope(_: float, x: np.ndarray) -> tuple[float, float]:
        known = {"angle": x[0], "velocity": x[1], "torque": torque}
        learned = force.at(*(np.array([known[axis.of]]) for axis in axes))[0]
        total = torque - B * x[1] - M * G * L * np.sin(x[0]) + learned
        return x[1], total / (M * L**2)

    start, T = np.array([0.3, 1.5]), 40
    theirs = solve_ivp(slope, (0, T * 0.01), start, rtol=1e-9, atol=1e-11).y[:, -1]
    plant = PENDULUM.with_learned([force])
    ours = plant.simulate(start[None], np.full((1, T, 1), torque), 0.01)[0, -1]
    np.testing.assert_allclose(ours, theirs, atol=2e-6)
    apart = PENDULUM.simulate(start[None], np.full((1, T, 1), torque), 0.01)[0, -1]
    assert np.abs(apart - theirs).max() > 0.05


def test_away_from_its_grid_a_force_is_nothing_to_the_last_bit() -> None:
    force = random_force(Axis("angle", 3.0, 4.0, 8), SPEED)
    start, push = np.array([[0.5, 1.0]]), np.zeros((1, 40, 1))
    plain = PENDULUM.simulate(start, push, 0.02)
    np.testing.assert_array_equal(PENDULUM.with_learned([force]).simulate(start, push, 0.02), plain)
    assert force.at(np.array([2.5]), np.array([0.0])) == 0.0


@pytest.mark.parametrize("axis", [ANGLE, SPEED])
def test_equal_weights_are_a_constant_inside_the_grid(axis: Axis) -> None:
    x = np.linspace(axis.low, axis.high, 200)
    inside = np.abs(axis.even(x)) < axis.places[-1] - axis.step
    rows = design((axis,), (x,))[inside]
    np.testing.assert_allclose(rows.sum(axis=1), 1.0)
    assert np.all(np.count_nonzero(rows, axis=1) <= 4)


@pytest.mark.parametrize("turns", [-3, 1, 20])
def test_a_closed_grid_is_the_same_in_every_turn(turns: int) -> None:
    q = np.linspace(-2.0, -2.0 + 2.0 * np.pi, 50)
    force, v = random_force(TURN, SPEED), np.linspace(-3.0, 3.0, 50)
    once, again = force.at(q, v), force.at(q + 2.0 * np.pi * turns, v)
    np.testing.assert_allclose(again, once, atol=1e-12)
    np.testing.assert_allclose(TURN.once(q[1:-1] + 2.0 * np.pi * turns), q[1:-1])
    plant = PENDULUM.with_learned([force])
    start = np.array([[3.0, 4.0]])
    moved, push = np.array([[2.0 * np.pi * turns, 0.0]]), np.zeros((1, 30, 1))
    apart = plant.simulate(start + moved, push, 0.02) - plant.simulate(start, push, 0.02)
    np.testing.assert_allclose(apart, moved * np.ones((1, 31, 1)), atol=1e-6)


def test_equal_weights_are_a_constant_all_around_a_closed_grid() -> None:
    rows = design((TURN,), (np.linspace(-20.0, 20.0, 300),))
    np.testing.assert_allclose(rows.sum(axis=1), 1.0)


def test_an_env_is_stepped_as_its_plant_is_simulated() -> None:
    plant = PENDULUM.with_learned([random_force(ANGLE, SPEED)])
    stepper = plant.stepper(0.02, 1)
    stepper.restart(np.array([True]), np.array([[0.3, 1.5]]))
    push = np.full((1, 10, 1), 0.4)
    steps = [stepper.advance(push[:, k])[0, 0] for k in range(10)]
    whole = plant.simulate(np.array([[0.3, 1.5]]), push, 0.02)[0, 1:]
    np.testing.assert_allclose(steps, whole, atol=1e-5)


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: Axis("angle", 1.0, 1.0, 9), "must have finite low < high"),
        (lambda: Axis("angle", 0.0, 1.0, 3), "4 to 200 knots, got .* 3 knots"),
        (lambda: Axis("angle", 0.0, float("nan"), 9), "finite low < high"),
        (lambda: Axis("angle", 0.0, 1.0, 9, slow=0.1, closed=True), "even where it is closed"),
        (lambda: LearnedForce("pendulum", (), ()), "one axis or two, got 0"),
        (lambda: LearnedForce("pendulum", (ANGLE,), (0.0,)), "15 finite weights.* got 1"),
        (lambda: LearnedForce("pendulum", (ANGLE,), (np.inf,) * 15), "15 finite weights"),
        (
            lambda: PENDULUM.with_learned([LearnedForce("elbow", (ANGLE,), (0.0,) * 15)]),
            "cannot act at 'elbow'; the joints are pendulum",
        ),
        (
            lambda: PENDULUM.with_learned(
                [LearnedForce("pendulum", (Axis("heat", 0.0, 1.0, 4),), (0.0,) * 4)]
            ),
            "cannot depend on 'heat'; the states and inputs are angle, velocity, torque",
        ),
    ],
)
def test_a_force_that_makes_no_sense_gets_a_sentence(make, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        make()
