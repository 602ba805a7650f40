"""Forces that remember move a joint as their differential equations say, integrated otherwise."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from envs.plants import PLANTS
from mcpilco.bodies import generalised_forces, mass_matrix
from mcpilco.plant.effects import CATALOGUE, memory
from mcpilco.plant.effects.memory import JointBacklash, Moment, RememberingForce
from mcpilco.plant.plant import EffectInstance, Plant

pytestmark = pytest.mark.xdist_group("motions")  # one process compiles what all of them need

DT, T = 0.02, 50
REMEMBERING = [effect for effect in CATALOGUE.values() if isinstance(effect, RememberingForce)]


def dahl(q, v, F, x, y, f_c, x_d):
    return -f_c * x, (v - abs(v) * x) / x_d, 0.0


def motor(q, v, F, x, y, b, T):
    return x - F, (F - b * v - x) / T, 0.0


def spring(q, v, F, x, y, I_m, k, z, g=0.0):
    """Of a motor at the angle x with the velocity y."""
    twist = x - q
    pressed = k * (twist - np.clip(twist, -g, g))
    if abs(twist) >= g:
        pressed += 2.0 * z * math.sqrt(k * I_m) * (y - v)
    return pressed - F, y, (F - pressed) / I_m


EQUATIONS: dict[str, Callable[..., Any]] = {
    "dahl_friction": dahl,
    "back_emf": motor,
    "elastic_joint": spring,
    "joint_backlash": spring,
}
"""force on the joint, and how fast the memory changes, of joint, motor's force and memory"""


def pendulum() -> Plant:
    return PLANTS["mcpilco/Pendulum-v0"]()


def having(name: str, values: list[float]) -> Plant:
    plant, effect = pendulum(), CATALOGUE[name]
    (target,) = effect.targets(plant.layout)
    return plant.having([(EffectInstance(effect, target), values)])


def torques() -> np.ndarray:
    return np.repeat(np.random.default_rng(0).uniform(-1.5, 1.5, T // 5), 5)


def equations(name: str, values: list[float], parts: int = 100) -> np.ndarray:
    """The motion from rest, by the classical method of Runge and Kutta in small steps."""
    plant = pendulum()
    known, chain, one = plant.values, plant.chain, np.zeros((1, 1))
    inertia = float(mass_matrix(chain, one)[0, 0, 0])
    weight = float(generalised_forces(chain, one + math.pi / 2, one, one)[0, 0])

    def slope(s: np.ndarray, F: float) -> np.ndarray:
        q, v, x, y = s
        force, dx, dy = EQUATIONS[name](q, v, F, x, y, *values)
        a = (F + force - known["friction"] * v - weight * math.sin(q)) / inertia
        return np.array([v, a, dx, dy])

    first = torques()[0]
    s, h = np.array([0.0, 0.0, *begun(name, values, first, inertia)]), DT / parts
    motion = [s]
    for F in torques():
        for _ in range(parts):
            k1 = slope(s, F)
            k2 = slope(s + h / 2 * k1, F)
            k3 = slope(s + h / 2 * k2, F)
            s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(s + h * k3, F))
        motion.append(s)
    return np.array(motion)[:, :2]


def begun(name: str, values: list[float], F: float, inertia: float) -> tuple[float, float]:
    """The memory of a motor that accelerates together with its joint."""
    if EQUATIONS[name] is not spring:
        return (F if name == "back_emf" else 0.0), 0.0
    rotor, k, _, *gap = values
    pressing = F * inertia / (inertia + rotor)
    return pressing / k + math.copysign(sum(gap), pressing), 0.0


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ("name", "values", "error"),
    [
        ("dahl_friction", [0.1, 1e-3], 1e-6),
        ("dahl_friction", [0.1, 0.05], 1e-6),
        ("back_emf", [0.2, 0.03], 3e-5),
        ("elastic_joint", [0.03, 30.0, 0.1], 3e-5),
        ("elastic_joint", [0.03, 300.0, 0.1], 3e-5),
        ("joint_backlash", [0.03, 300.0, 0.3, 0.02], 2e-3),
    ],
)
def test_a_motion_is_that_of_the_differential_equations(name, values, error):
    """Far below any encoder; behind a play, of which each blow leads to the next, near it."""
    start, u = np.zeros((1, 2)), torques()[None, :, None]
    ours = having(name, values).simulate(start, u, DT)[0]
    theirs = equations(name, values)
    still = pendulum().simulate(start, u, DT)[0]
    assert np.abs(ours - still)[:, 0].max() > 0.02
    np.testing.assert_allclose(ours[:, 0], theirs[:, 0], rtol=0.0, atol=error)


@pytest.mark.parametrize("effect", REMEMBERING, ids=lambda effect: effect.name)
def test_a_stepper_remembers_what_a_simulation_does(effect):
    values = {"dahl_friction": [0.1, 0.02], "back_emf": [0.2, 0.03]}
    own = values.get(effect.name, [0.03, 300.0, 0.3, 0.01][: len(effect.symbols)])
    plant = having(effect.name, own)
    u = torques()
    whole = plant.simulate(np.zeros((1, 2)), u[None, :, None], DT)[0]
    stepper = plant.stepper(DT, 1)
    stepped = [stepper.advance(np.array([[command]]))[-1, 0] for command in u]
    np.testing.assert_allclose(np.array(stepped)[:, 0], whole[1:, 0], rtol=0.0, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "values", "limit", "theirs"),
    [
        ("dahl_friction", [0.1, 1e-5], "coulomb_friction", [0.1, 5e-4]),
        ("back_emf", [0.1, 1e-6], "viscous_friction", [0.1]),
        ("back_emf", [0.1, 0.0], "viscous_friction", [0.1]),
        ("back_emf", [0.0, 0.05], "actuator_lag", [0.05]),
        ("elastic_joint", [0.03, 1e4, 0.1], "armature", [0.03]),
        ("joint_backlash", [0.03, 30.0, 0.1, 0.0], "elastic_joint", [0.03, 30.0, 0.1]),
    ],
)
def test_a_limit_of_an_effect_is_its_special_case(name, values, limit, theirs):
    (general,), (special,) = (having(*each).added for each in ((name, values), (limit, theirs)))
    assert general[0].holds(special[0])
    start, u = np.array([[0.2, 1.0]]), torques()[None, :, None]
    found = having(name, values).simulate(start, u, DT)
    np.testing.assert_allclose(found, having(limit, theirs).simulate(start, u, DT), atol=3e-2)
    angle = found - having(limit, theirs).simulate(start, u, DT)
    assert np.abs(angle[..., 0]).max() < 1.5e-3


@pytest.mark.parametrize("way", [0.3, -0.02, 1e-4])
def test_two_ways_in_one_direction_are_one(way):
    """Friction before sliding does not depend on the time that a way takes, nor on its parts."""
    follow = CATALOGUE["dahl_friction"].follow
    q = np.array([0.0, 0.4, 1.0]) * way
    there, half, end = (Moment(x, math.copysign(1.0, way), np.nan, 0.0) for x in q)
    once = follow((-0.3, 0.0), 0.1, there, end, 0.2, 0.05)
    twice = follow(follow((-0.3, 0.0), 0.1, there, half, 0.2, 0.05), 5.0, half, end, 0.2, 0.05)
    np.testing.assert_allclose(once, twice, rtol=1e-12)


def test_friction_before_sliding_takes_energy_from_a_swing_and_holds_a_joint_at_rest():
    """A pendulum sticks where gravity pulls less than the friction, after a few ways x_d."""
    plant = having("dahl_friction", [0.5, 0.01])
    rest = plant.simulate(np.array([[0.1, 0.0]]), np.zeros((1, 1500, 1)), DT)[0]
    assert np.abs(rest[:, 0] - 0.1).max() < 0.05
    assert np.ptp(rest[-500:, 0]) < 1e-3
    swing = plant.simulate(np.array([[2.0, 0.0]]), np.zeros((1, 1500, 1)), DT)[0]
    known = plant.values
    height = known["mass"] * known["gravity"] * known["length"] * (1.0 - np.cos(swing[:, 0]))
    energy = 0.5 * known["mass"] * known["length"] ** 2 * swing[:, 1] ** 2 + height
    assert (energy[25:] < energy[:-25])[energy[25:] > 1.0].all()  # a spring gives some back
    assert np.abs(swing[-100:, 1]).max() < 1e-3


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("dahl_friction", [0.4, 0.05]),
        ("back_emf", [0.2, 0.1]),
        ("elastic_joint", [0.03, 3.0, 0.1]),
        ("joint_backlash", [0.03, 30.0, 0.1, 0.1]),
    ],
)
def test_a_motion_that_knows_how_it_began_goes_on_as_it_did(name, values):
    """From its middle alone it would not: the memory is not in the state."""
    plant, lead, each = having(name, values), T, np.zeros(1, dtype=np.int64)
    u = np.concatenate([torques(), -torques()])[None, :, None]
    whole = plant.simulate(np.array([[0.2, 0.0]]), u, DT)[0]
    before, after = whole[: lead + 1], whole[lead : 2 * lead]
    rest = plant.tables(plant.nominal[None]), each, before[-1:], each, u, lead, DT
    known = plant.run(*rest, path=before[None])[0].T
    unknown = plant.run(*rest)[0].T
    error, without = (np.abs(found - after)[:, 0].max() for found in (known, unknown))
    assert error < 0.2 * without
    assert error < 0.02 * np.ptp(after[:, 0])


@pytest.mark.parametrize(
    ("x", "values"),
    [
        (0.0, [1.6e-9, 0.26, 0.1, 1e12]),  # in the middle of a play that it does not get out of
        (2.4, [1.6e-9, 0.26, 0.1, 0.5]),  # at its usual twist
        (-0.4, [1e-6, 1e6, 0.02, 0.4]),
    ],
    ids=["flies", "presses", "rings"],
)
def test_the_work_of_a_step_has_a_limit_however_quick_the_spring(x, values, monkeypatch):
    """Springs of 1e4 and 1e6 rad/s, over 20 ms: parts of 0.2 rad would be 1,300 and 100,000."""
    parts = 0

    def counted(a: float, b: float) -> float:
        nonlocal parts
        parts += 1
        return min(a, b)

    monkeypatch.setattr(memory, "smaller", counted)
    side = -1.0 if x < 0.0 else 1.0
    before, now = Moment(0.0, 0.1, 0.5, 0.5 * side), Moment(0.002, 0.11, 0.5, 0.52 * side)
    ahead, speed = JointBacklash.follow((x, 0.0), DT, before, now, *values)
    I_m, k, _, g = values
    if g > 1e3:
        turned = DT**2 * (2.0 * before.F + now.F) / (6.0 * I_m) - 0.5 * before.a * DT**2
        assert (ahead, speed) == pytest.approx((turned, DT * (0.51 / I_m - 0.5)), rel=1e-9)
        assert parts <= 4
    else:
        assert ahead == pytest.approx(side * (g + abs(now.F) / k), rel=1e-3)
        assert parts <= 16000
