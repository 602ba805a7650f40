"""Laws of all effects, on every plant and at every target."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from envs.plants import PLANTS
from mcpilco.bodies import generalised_forces
from mcpilco.plant.effects import CATALOGUE, Scale
from mcpilco.plant.plant import EffectInstance, Plant
from mcpilco.plant.simulation.layout import Tables
from mcpilco.plant.simulation.motion import simulate

DT, T = 0.02, 50
CASES = [
    pytest.param(name, active, id=f"{active}-{name.removeprefix('mcpilco/')}")
    for name, make in PLANTS.items()
    for active in make().candidates()
]
everywhere = pytest.mark.parametrize(("plant_name", "active"), CASES)


def sign(v):
    """As dry friction here turns over."""
    return np.tanh(v / 5e-3)


class Row(NamedTuple):
    """An effect in these tests."""

    values: list[float]
    """that are noticeable"""
    units: tuple[str | None, str | None]
    """of the symbols at a cart, and at its pole"""
    formula: Callable[..., Any] | None = None
    """of a force in a joint: its docstring, at these values"""


ROWS = {
    "viscous_friction": Row([0.2], ("N s/m", "N m s/rad"), lambda q, v: -0.2 * v),
    "coulomb_friction": Row([0.3, 5e-3], ("N, m/s", "N m, rad/s"), lambda q, v: -0.3 * sign(v)),
    "stribeck_friction": Row(
        [0.2, 0.1, 0.5, 5e-3],
        ("N, N, m/s, m/s", "N m, N m, rad/s, rad/s"),
        lambda q, v: -(0.2 + 0.1 * np.exp(-((v / 0.5) ** 2))) * sign(v),
    ),
    "quadratic_drag": Row([0.1], ("N s^2/m^2", "N m s^2/rad^2"), lambda q, v: -0.1 * v * np.abs(v)),
    "asymmetric_friction": Row(
        [0.3, 0.1, 5e-3],
        ("N, N, m/s", "N m, N m, rad/s"),
        lambda q, v: -np.where(v > 0, 0.3, 0.1) * sign(v),
    ),
    "asymmetric_viscous_friction": Row(
        [0.2, 0.1],
        ("N s/m, N s/m", "N m s/rad, N m s/rad"),
        lambda q, v: -np.where(v > 0, 0.2, 0.1) * v,
    ),
    "load_dependent_friction": Row([0.2, 5e-3], ("-, m/s", "-, rad/s")),
    "spring": Row([1.5], ("N/m", "N m/rad"), lambda q, v: -1.5 * q),
    "hardening_spring": Row([0.7], ("N/m^3", "N m/rad^3"), lambda q, v: -0.7 * q**3),
    "constant_force": Row([-0.4], ("N", "N m"), lambda q, v: np.full_like(q, -0.4)),
    "position_ripple": Row(
        [0.3, -0.2, 5.0],
        ("N, N, 1/m", "N m, N m, 1/rad"),
        lambda q, v: 0.3 * np.sin(5.0 * q) - 0.2 * np.cos(5.0 * q),
    ),
    "dahl_friction": Row([0.3, 0.01], ("N, m", "N m, rad")),
    "back_emf": Row([0.2, 0.02], ("N s/m, s", None)),
    "elastic_joint": Row([0.02, 20.0, 0.1], ("N s^2/m, N/m, -", None)),
    "joint_backlash": Row([0.02, 20.0, 0.1, 0.01], ("N s^2/m, N/m, -, m", None)),
    "body_mass": Row([0.1], ("kg", "kg")),
    "center_of_mass": Row([0.05], (None, "m")),
    "body_inertia": Row([0.004], (None, "kg m^2")),
    "armature": Row([0.01], ("N s^2/m", "N m s^2/rad")),
    "body_length": Row([0.05], (None, "m")),
    "actuator_gain": Row([0.8], ("-", None)),
    "actuator_dead_zone": Row([0.5], ("N", None)),
    "asymmetric_dead_zone": Row([0.5, 0.2], ("N, N", None)),
    "actuator_saturation": Row([1.0], ("N", None)),
    "actuator_delay": Row([0.03], ("s", None)),
    "actuator_lag": Row([0.03], ("s", None)),
    "actuator_rate_limit": Row([10.0], ("N/s", None)),
    "backlash": Row([0.3], ("N", None)),
    "sensor_offset": Row([0.1], ("m", "rad")),
    "sensor_scale": Row([1.1], ("-", "-")),
    "sensor_delay": Row([0.03], ("s", "s")),
    "sensor_lag": Row([0.03], ("s", "s")),
    "eccentric_encoder": Row([0.1, -0.05], (None, "rad, rad")),
    "gravity_tilt": Row([0.05], ("rad", None)),
    "contact_friction": Row([0.5], (None, None)),
    "contact_stiffness": Row([0.5], (None, None)),
    "contact_damping": Row([0.5], (None, None)),
    "ground_height": Row([0.02], (None, None)),
}
ORDINARY = {name: row.values for name, row in ROWS.items()}
FORMULAS = {name: row.formula for name, row in ROWS.items() if row.formula}
at_joints = pytest.mark.parametrize(
    ("plant_name", "active"), [c for c in CASES if c.values[1].effect.name in FORMULAS]
)


@cache
def setting(plant_name: str) -> tuple[Plant, np.ndarray, np.ndarray]:
    """A plant, two starts (2, X) and the commands (2, T, U) of two motions."""
    plant = PLANTS[plant_name]()
    rng = np.random.default_rng(0)
    X, U = len(plant.layout.states), len(plant.layout.inputs)
    levels = rng.uniform(-3.0, 3.0, (2, T // 5, U))
    return plant, rng.normal(0, 0.7, (2, X)), np.repeat(levels, 5, axis=1)


def usual() -> Scale:
    """At every target of the motions here, roughly."""
    return Scale(
        position=2.0,
        velocity=2.0,
        force=2.0,
        command=3.0,
        signal=1.0,
        inertia=0.05,
        mass=0.5,
        length=0.25,
        dt=DT,
    )


def tables(plant: Plant, active: EffectInstance | None = None, *values: np.ndarray) -> Tables:
    """Of as many systems as there are values."""
    rows = np.tile(plant.nominal, (max(len(values), 1), 1))
    return plant.tables(rows, [active] if active else [], [np.array(values)] if active else [])


def measured(plant_name: str, systems: Tables) -> np.ndarray:
    """(S, 2, X, T) of both motions of each system."""
    _, start, commands = setting(plant_name)
    S = len(systems.chains.mass)
    system, window = np.repeat(np.arange(S), 2), np.tile([0, 1], S)
    y = simulate(systems, system, start[window], window, commands, 0, DT)
    return y.reshape(S, 2, *y.shape[1:])


@cache
def nominal(plant_name: str) -> np.ndarray:
    plant = setting(plant_name)[0]
    return measured(plant_name, tables(plant))[0]


def test_an_effect_stands_under_its_own_name():
    assert all(name == effect.name for name, effect in CATALOGUE.items())
    assert len({type(effect) for effect in CATALOGUE.values()}) == len(CATALOGUE)
    assert list(ROWS) == list(CATALOGUE)


@pytest.mark.parametrize("name", CATALOGUE)
def test_neutral_values_make_physical_sense(name):
    for symbol in CATALOGUE[name].symbols:
        assert symbol.low <= symbol.neutral <= symbol.high
        assert symbol.reported or symbol.name == "v_r"
    names = [symbol.name for symbol in CATALOGUE[name].symbols]
    assert len(set(names)) == len(names)


@everywhere
def test_neutral_values_change_nothing(plant_name, active):
    plant = setting(plant_name)[0]
    found = measured(plant_name, tables(plant, active, active.effect.neutral))[0]
    np.testing.assert_array_equal(found, nominal(plant_name))


@pytest.mark.one_in(2)
@everywhere
def test_neutral_values_change_nothing_where_the_plant_has_the_effect_already(plant_name, active):
    values = ORDINARY[active.effect.name]
    plant = setting(plant_name)[0].having([(active, values)])
    before = measured(plant_name, tables(plant))
    found = measured(plant_name, tables(plant, active, active.effect.neutral))
    np.testing.assert_array_equal(found, before)
    assert np.abs(before[0] - nominal(plant_name)).max() > 1e-3


@everywhere
def test_every_probe_is_felt(plant_name, active):
    """Above the tolerances of a step."""
    plant = setting(plant_name)[0]
    for probe in active.effect.probes(usual()):
        found = measured(plant_name, tables(plant, active, *probe.values))
        change = np.abs(found - nominal(plant_name)).reshape(len(found), -1).max(axis=1)
        assert np.isfinite(found).all()
        assert (change > 2e-4).all()


@everywhere
def test_probes_make_physical_sense(plant_name, active):
    low = [symbol.low for symbol in active.effect.symbols]
    high = [symbol.high for symbol in active.effect.symbols]
    for probe in active.effect.probes(usual()):
        assert probe.values.shape[1] == len(low)
        assert (probe.values >= low).all()
        assert (probe.values <= high).all()


@pytest.mark.one_in(2)
@everywhere
def test_an_effect_in_one_system_leaves_the_others_alone(plant_name, active):
    plant = setting(plant_name)[0]
    neutral, values = active.effect.neutral, np.array(ORDINARY[active.effect.name])
    found = measured(plant_name, tables(plant, active, neutral, values, neutral))
    np.testing.assert_array_equal(found[0], nominal(plant_name))
    np.testing.assert_array_equal(found[2], nominal(plant_name))
    assert np.abs(found[1] - nominal(plant_name)).max() > 1e-3


@at_joints
def test_the_force_of_an_effect_is_what_the_motion_shows(plant_name, active):
    """tau = M(q) q'' + bias of the simulated motion, less what drives the nominal plant."""
    plant, dt = setting(plant_name)[0], 2e-4
    layout, rng, N = plant.layout, np.random.default_rng(3), 20
    J = len(layout.joints)
    start = rng.normal(0, 1.0, (N, 2 * J))
    start[:, 1::2] += 0.3 * np.sign(start[:, 1::2])  # dry friction holds its sign
    having = plant.having([(active, ORDINARY[active.effect.name])])
    y = having.simulate(start, np.zeros((N, 4, len(layout.inputs))), dt)
    q, v = y[:, 2, 0::2], y[:, 2, 1::2]
    # central difference of fourth order
    dv = (y[:, 0] - 8.0 * y[:, 1] + 8.0 * y[:, 3] - y[:, 4])[:, 1::2] / (12.0 * dt)
    values = {parameter.name: parameter.value for parameter in plant.parameters}
    tau = generalised_forces(plant.build(values), q, v, dv)
    for base in plant.base:
        if base.active.effect.name == "viscous_friction":
            j = layout.joints.index(base.active.target)
            tau[:, j] += values[base.values[0]] * v[:, j]
    expected = np.zeros((N, J))
    j = layout.joints.index(active.target)
    expected[:, j] = FORMULAS[active.effect.name](q[:, j], v[:, j])
    np.testing.assert_allclose(tau, expected, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("name", FORMULAS)
def test_friction_brakes_and_springs_pull_back(name):
    """At every value that makes physical sense; a constant force and a ripple may do both."""
    effect = CATALOGUE[name]
    free = {"constant_force", "position_ripple"}
    signed = [s for s in effect.symbols if s.reported and not s.unit.endswith("{q}/s")]
    assert all((symbol.low == 0.0) != (name in free) for symbol in signed if symbol.name != "n")
    q = v = np.linspace(-2.0, 2.0, 40)
    if name not in free:
        against = q if "spring" in name else v
        assert (FORMULAS[name](q, v) * against <= 0.0).all()


def test_an_effect_that_others_make_does_what_they_do_together():
    coulomb, constant, both = (
        CATALOGUE[name] for name in ("coulomb_friction", "constant_force", "asymmetric_friction")
    )
    parts = {coulomb.name: [0.4, 1e-3], constant.name: [-0.1]}
    values = both.made_of(parts)
    v = np.array([-2.0, -0.5, 0.3, 3.0])
    together = coulomb.force(0.0, v, *parts[coulomb.name]) + constant.force(0.0, v, -0.1)
    np.testing.assert_allclose(both.force(0.0, v, *values), together)
    assert both.made_of({coulomb.name: [0.4, 1e-3]}) is None
    assert coulomb.made_of(parts) is None


@pytest.mark.parametrize(
    ("name", "at"),
    [
        ("viscous_friction", lambda scale: scale.velocity),
        ("quadratic_drag", lambda scale: scale.velocity**2),
        ("coulomb_friction", lambda scale: 1.0),
        ("spring", lambda scale: scale.position),
        ("hardening_spring", lambda scale: scale.position**3),
        ("constant_force", lambda scale: 1.0),
        ("position_ripple", lambda scale: 1.0),
    ],
)
def test_a_force_of_thirty_times_the_usual_one_is_the_largest_that_is_meant(name, at):
    scale, effect = usual(), CATALOGUE[name]
    largest = effect.largest(scale)
    sizes = np.array([symbol.neutral == 0.0 for symbol in effect.symbols])
    np.testing.assert_allclose(largest[sizes] * at(scale), 30.0 * scale.force)
    assert np.isinf(largest[~sizes]).all()


@pytest.mark.parametrize("name", ["actuator_dead_zone", "asymmetric_dead_zone"])
def test_no_dead_zone_is_meant_that_leaves_nothing_of_the_largest_command(name):
    largest = CATALOGUE[name].largest(scale := usual())
    np.testing.assert_array_equal(largest, scale.command)


@pytest.mark.parametrize(
    ("position", "least", "count"),
    [(0.3, 150.0, 60), (3.0, 39.0, 72), (10.0, 38.0, 240), (40.0, 11.0, 240)],
)
def test_waves_of_a_ripple_are_sought_up_to_a_motors_slots_however_far_it_turned(
    position, least, count
):
    probes = CATALOGUE["position_ripple"].probes(dataclasses.replace(usual(), position=position))
    waves = np.array([probe.values[0, 2] for probe in probes])
    # one spans the places at least: less of it is an offset and a spring
    assert (waves[0], len(waves)) == (max(2.0, np.pi / position), count)
    assert waves[-1] > least
    # neighbours are half a period apart from one end of what was visited to the other
    assert np.diff(waves) * 2.0 * max(position, 0.5) == pytest.approx(np.pi)


def test_an_offset_of_a_carts_position_is_another_start():
    """Nothing depends on where on its rail a cart is: no recording can tell these two apart."""
    plant, start, commands = setting("mcpilco/CartPoleSwingUp-v0")
    offset = EffectInstance(CATALOGUE["sensor_offset"], "cart_position")
    shifted = np.add(start, [0.1, 0.0, 0.0, 0.0])
    found = plant.having([(offset, [0.1])]).simulate(start, commands, DT)
    np.testing.assert_allclose(found, plant.simulate(shifted, commands, DT), atol=1e-9)


def test_an_offset_of_an_angle_is_no_other_start():
    plant, start, commands = setting("mcpilco/Pendulum-v0")
    offset = EffectInstance(CATALOGUE["sensor_offset"], "angle")
    found = plant.having([(offset, [0.1])]).simulate(start, commands, DT)
    other = plant.simulate(np.add(start, [0.1, 0.0]), commands, DT)
    assert np.abs(found - other).max() > 0.01


@pytest.mark.parametrize("name", CATALOGUE)
def test_units_are_those_of_the_target(name):
    layout = PLANTS["mcpilco/CartPoleSwingUp-v0"]().layout
    effect = CATALOGUE[name]
    for target in effect.targets(layout):
        found = ", ".join(effect.units(layout, target))
        j = layout.joint_of(target)
        expected = ROWS[name].units[j]
        if target.endswith("velocity") and name == "sensor_offset":
            expected += "/s"
        assert found == expected
