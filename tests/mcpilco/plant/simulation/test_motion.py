"""Motions against the envs' integrator, and against scipy's with every part of a system."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lsim, lti

from envs.plants import cart_pole, double_pendulum, pendulum
from mcpilco.bodies import generalised_forces
from mcpilco.plant.effects import CATALOGUE
from mcpilco.plant.plant import EffectInstance, Plant
from mcpilco.plant.simulation.layout import RATE
from mcpilco.plant.simulation.motion import _follow, accuracy_for, simulate
from tests.mcpilco.plant.effects.test_catalogue import FORMULAS, ORDINARY
from tests.mcpilco.plant.simulation.reference import pendulum_motion
from tests.reference.cartpole import CartPoleDynamics

DT, T = 0.02, 20
START = np.array([0.4, 1.0])
PULSES = np.array([2.0] * 5 + [-1.5] * 5 + [0.3, -0.3, 0.6, 2.5, -2.5, 0.1, 0.0, 1.0, 1.0, 1.0])
CLOSE = {"rtol": 0.0, "atol": 5e-5}
"""five times the tolerance of a step in a velocity [rad, rad/s]"""


def having(*effects: tuple[str, str, list[float]]) -> Plant:
    """The pendulum with effects: name, target, values."""
    return pendulum().having(
        [(EffectInstance(CATALOGUE[n], target), v) for n, target, v in effects]
    )


def followed(plant: Plant, commands: np.ndarray = PULSES, start: np.ndarray = START) -> np.ndarray:
    """What is measured of one motion."""
    return plant.simulate(start[None], commands[None, :, None], DT)[0]


def test_a_cart_pole_moves_as_the_env_integrates_it():
    rng = np.random.default_rng(0)
    states, commands = rng.normal(0, [1, 1, 2, 3], (3, 4)), rng.uniform(-10, 10, (3, 25, 1))
    found = cart_pole().simulate(states, commands, DT)
    for k in range(25):
        np.testing.assert_allclose(found[:, k], states, **CLOSE)
        states = CartPoleDynamics.nominal().advance(states, commands[:, k, 0], DT)[-1]
    np.testing.assert_allclose(found[:, 25], states, **CLOSE)


def test_one_compiled_loop_serves_starts_in_any_layout():
    starts, commands = np.random.default_rng(1).normal(size=(3, 4)), np.ones((3, 5, 1))
    expected, compiled = cart_pole().simulate(starts, commands, DT), set(_follow.signatures)
    found = cart_pole().simulate(np.asfortranarray(starts), commands, DT)
    np.testing.assert_array_equal(found, expected)
    assert set(_follow.signatures) == compiled


@pytest.mark.parametrize("name", FORMULAS)
def test_a_joint_law_moves_a_pendulum_as_scipy_says(name):
    values, law = ORDINARY[name], FORMULAS[name]
    truth = pendulum_motion(START, PULSES, DT, law=law)
    expected = [truth.at(k * DT) for k in range(T + 1)]
    np.testing.assert_allclose(followed(having((name, "pendulum", values))), expected, **CLOSE)


@pytest.mark.parametrize(
    "effect", [None, ("sensor_delay", "angle", [0.013]), ("actuator_delay", "actuator", [0.0137])]
)
def test_commands_keep_their_rate_where_few_samples_are_compared(effect):
    """Also where a sensor looks back, or an actuator waits, by a part of a command's time."""
    plant = having(effect) if effect else pendulum()
    fast = np.random.default_rng(0).uniform(-2, 2, (1, 8 * T, 1))
    tables, each = plant.tables(plant.nominal[None]), np.zeros(1, dtype=int)
    start, past = START[None], np.zeros((1, 24, 1))
    commands = np.concatenate([past, fast], axis=1)
    every_one = simulate(tables, each, start, each, commands, 24, DT / 8)
    every_eighth = simulate(tables, each, start, each, commands, 24, DT / 8, every=8)
    assert every_eighth.shape == (1, 2, T)
    np.testing.assert_allclose(every_eighth, every_one[:, :, ::8], atol=1e-12)


@pytest.mark.parametrize(
    "effects",
    [[], [("actuator_lag", [0.05])], [("actuator_lag", [0.05]), ("actuator_delay", [0.31])]],
)
def test_only_commands_that_an_actuator_has_forgotten_are_left_out(effects):
    """An actuator with a limit of its rate forgets none; that of this one is never met."""
    plant = having(*((name, "actuator", values) for name, values in effects))
    tables, each = plant.tables(plant.nominal[None]), np.zeros(1, dtype=int)
    commands = np.random.default_rng(0).uniform(-2, 2, (1, 200 + T, 1))
    found = simulate(tables, each, START[None], each, commands, 200, DT)
    tables.actuators[:, :, RATE] = 1e15
    whole = simulate(tables, each, START[None], each, commands, 200, DT)
    np.testing.assert_allclose(found, whole, rtol=0.0, atol=1e-9)


def play(commands: np.ndarray, width: float) -> np.ndarray:
    """The nearest force to the last one that is within `width` of the command."""
    forces = [commands[0]]
    for command in commands:
        forces.append(float(np.clip(forces[-1], command - width, command + width)))
    return np.array(forces[1:])


ACTUATORS = {
    "gain": ([("actuator_gain", 0.7)], 0.7 * PULSES, {}),
    "dead zone": (
        [("actuator_dead_zone", 0.4)],
        np.sign(PULSES) * np.maximum(np.abs(PULSES) - 0.4, 0.0),
        {},
    ),
    "dead zone of two ends": (
        [("asymmetric_dead_zone", (0.4, 0.1))],
        np.where(PULSES > 0, np.maximum(PULSES - 0.4, 0.0), np.minimum(PULSES + 0.1, 0.0)),
        {},
    ),
    "limit": ([("actuator_saturation", 1.2)], np.clip(PULSES, -1.2, 1.2), {}),
    "play": ([("backlash", 0.35)], play(PULSES, 0.35), {}),
    "gain, then play": (
        [("backlash", 0.35), ("actuator_gain", 0.5)],
        play(0.5 * PULSES, 0.35),
        {},
    ),
    "delay within a sample": ([("actuator_delay", 0.013)], PULSES, {"delay": 0.013}),
    "delay of 2.35 samples": ([("actuator_delay", 0.047)], PULSES, {"delay": 0.047}),
    "delay of 3 samples": ([("actuator_delay", 0.06)], PULSES, {"delay": 0.06}),
    "delay of 5 samples": ([("actuator_delay", 0.1)], PULSES, {"delay": 0.1}),
    "lag": ([("actuator_lag", 0.03)], PULSES, {"lag": 0.03}),
    "limit, delay and lag": (
        [("actuator_lag", 0.05), ("actuator_delay", 0.031), ("actuator_saturation", 1.2)],
        np.clip(PULSES, -1.2, 1.2),
        {"lag": 0.05, "delay": 0.031},
    ),
}


@pytest.mark.parametrize("case", ACTUATORS)
def test_an_actuator_moves_a_pendulum_as_scipy_says(case):
    effects, forces, memory = ACTUATORS[case]
    truth = pendulum_motion(START, forces, DT, **memory)
    expected = [truth.at(k * DT) for k in range(T + 1)]
    plant = having(*((name, "actuator", np.atleast_1d(value)) for name, value in effects))
    np.testing.assert_allclose(followed(plant), expected, **CLOSE)


@pytest.mark.parametrize("latency", [0.0, 0.004, 0.02, 0.03, 0.04, 0.06, 0.1, 0.07, 0.5])
def test_a_sensor_tells_the_state_of_before(latency):
    truth = pendulum_motion(START, PULSES, DT)
    plant = having(
        ("sensor_delay", "velocity", [latency]),
        ("sensor_scale", "velocity", [1.3]),
        ("sensor_offset", "velocity", [0.2]),
    )
    found = followed(plant)
    expected = [0.2 + 1.3 * truth.at(k * DT - latency)[1] for k in range(T + 1)]
    np.testing.assert_allclose(found[:, 1], expected, **CLOSE)
    np.testing.assert_allclose(found[:, 0], [truth.at(k * DT)[0] for k in range(T + 1)], **CLOSE)


def test_each_sensor_looks_at_its_own_time():
    truth = pendulum_motion(START, PULSES, DT)
    found = followed(
        having(("sensor_delay", "angle", [0.013]), ("sensor_delay", "velocity", [0.031]))
    )
    times = np.arange(T + 1) * DT
    expected = [[truth.at(t - 0.013)[0], truth.at(t - 0.031)[1]] for t in times]
    np.testing.assert_allclose(found, expected, **CLOSE)


@pytest.mark.parametrize("lag", [0.004, 0.03])
def test_a_filter_lags_behind_a_state_as_scipy_says(lag):
    truth = pendulum_motion(START, PULSES, DT)
    found = followed(having(("sensor_lag", "angle", [lag]), ("sensor_scale", "angle", [1.3])))
    begun = START[0] - lag * START[1]
    fine = np.arange(0.0, T * DT + 1e-9, 1e-3)
    angle = [truth.at(t)[0] for t in fine]
    system = lti([1.0], [lag, 1.0])
    _, filtered, _ = lsim(system, angle, fine, X0=[begun * lag])
    np.testing.assert_allclose(found[:, 0], 1.3 * filtered[::20], rtol=0.0, atol=1e-4)
    assert np.abs(found[:, 0] / 1.3 - angle[::20]).max() > 5e-3


@pytest.mark.parametrize("state", ["angle", "velocity"])
def test_a_filter_begins_with_what_a_measured_path_says_of_it(state):
    """Alike whether a motion is followed from its start, or from the middle with its path."""
    half, x = T // 2, ["angle", "velocity"].index(state)
    plant = having(("sensor_lag", state, [0.03]), ("sensor_scale", state, [1.3]))
    tables, each = plant.tables(plant.nominal[None]), np.zeros(1, dtype=int)
    whole, motion = followed(plant), followed(pendulum())
    path = np.stack([(whole if x == 0 else motion)[: half + 1, 0], motion[: half + 1, 1]], axis=1)
    given = motion[half][None], each, PULSES[None, :, None], half, DT
    known = simulate(tables, each, *given, path=path[None])[0]
    np.testing.assert_allclose(known[x], whole[half:-1, x], rtol=0.0, atol=2e-3)
    assert np.abs(simulate(tables, each, *given)[0, x] - whole[half:-1, x]).max() > 0.02


def test_an_eccentric_disc_is_seen_at_its_angle():
    angle = followed(pendulum())[:, 0]
    found = followed(having(("eccentric_encoder", "angle", [0.1, -0.05])))[:, 0]
    expected = angle + 0.1 * np.sin(angle) - 0.05 * np.cos(angle)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_friction_of_a_load_takes_a_part_of_the_drive():
    """As long as the joint keeps its direction: the share that friction takes of every force."""
    forces = np.abs(PULSES)
    start = np.array([0.0, 3.0])
    found = followed(having(("load_dependent_friction", "pendulum", [0.3, 5e-3])), forces, start)
    truth = pendulum_motion(start, 0.7 * forces, DT)
    forward = found[:, 1] > 0.1
    until = len(forward) if forward.all() else int(np.argmin(forward))
    assert until > 5
    expected = [truth.at(k * DT) for k in range(until)]
    np.testing.assert_allclose(found[:until], expected, **CLOSE)


@pytest.mark.parametrize("rate", [400.0, 60.0, 15.0])
def test_a_force_that_is_slow_ramps_to_its_command(rate):
    """Against a drive that is told ten thousand times a second how far it has come."""
    fine = np.repeat(PULSES, 200)
    ramp, force = np.empty_like(fine), PULSES[0]
    for k, goal in enumerate(fine):
        before, force = force, float(np.clip(goal, force - rate * 1e-4, force + rate * 1e-4))
        ramp[k] = 0.5 * (before + force)
    truth = pendulum().simulate(START[None], ramp[None, :, None], 1e-4)[0, ::200]
    found = followed(having(("actuator_rate_limit", "actuator", [rate])))
    np.testing.assert_allclose(found, truth, **CLOSE)


def test_a_slow_force_behind_a_lag_goes_on_to_its_command():
    """Where both act no ramp has an end that could be met."""
    both = having(("actuator_rate_limit", "actuator", [15.0]), ("actuator_lag", "actuator", [0.03]))
    lags, ramps = having(("actuator_lag", "actuator", [0.03])), followed(both)
    assert np.isfinite(ramps).all()
    assert np.abs(ramps - followed(lags)).max() > 0.1


def test_a_tilted_base_is_another_zero_of_the_angle():
    tilted = followed(having(("gravity_tilt", "pendulum", [0.2])))
    turns = np.array([[0.2, 0.0], [-0.2, 0.0]])
    shifted = [followed(pendulum(), start=START + turn) - turn for turn in turns]
    assert min(np.abs(tilted - other).max() for other in shifted) < 5e-5


def test_a_longer_body_carries_the_next_one_further_out():
    plant, more = double_pendulum(), 0.07
    values = {parameter.name: parameter.value for parameter in plant.parameters}
    length = values["upper_length"] + more
    ratio = values["upper_length"] / length  # center and inertia are told by the length
    center, inertia = values["upper_center"] * ratio, values["upper_inertia"] * ratio**2
    known = plant.where(upper_length=length, upper_center=center, upper_inertia=inertia)
    longer = plant.having([(EffectInstance(CATALOGUE["body_length"], "upper"), [more])])
    start, commands = np.array([[0.5, 1.0, -1.0, 2.0]]), np.zeros((1, T, 2))
    found, expected = (p.simulate(start, commands, DT) for p in (longer, known))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.abs(found - plant.simulate(start, commands, DT)).max() > 0.01


def test_a_double_pendulum_without_friction_keeps_its_energy():
    plant = double_pendulum().where(shoulder_friction=0.0, elbow_friction=0.0)
    chain = plant.chain
    start = np.array([[2.5, 0.0, -1.0, 3.0]])
    y = plant.simulate(start, np.zeros((1, 100, 2)), DT)[0]
    q, dq, rest = y[:, 0::2], y[:, 1::2], np.zeros((101, 2))
    weight = generalised_forces(chain, q, rest, rest)
    kinetic = 0.5 * np.sum(dq * (generalised_forces(chain, q, rest, dq) - weight), axis=1)
    heights = -np.stack([np.cos(q[:, 0]), np.cos(q.sum(axis=1))], axis=1)
    potential = 9.82 * heights @ [0.6 * 0.15 + 0.4 * 0.3, 0.4 * 0.15]
    energy = kinetic + potential
    np.testing.assert_allclose(energy, energy[0], atol=2e-5)
    assert np.ptp(kinetic) > 1.0


@pytest.mark.parametrize("noise", [1e-6, 1e-4, 1e-2])
def test_noisy_readings_allow_coarse_steps_whose_error_stays_far_below_the_noise(noise):
    plant = double_pendulum()
    commands = np.random.default_rng(0).uniform(-0.5, 0.5, (1, 51, len(plant.layout.inputs)))
    start, std = np.array([[0.5, 0.0, -0.3, 0.0]]), np.array([noise, 10 * noise] * 2)
    exact, steps = [], np.zeros((2, 1), dtype=np.int64)
    for taken, accuracy in zip(steps, (0.1, accuracy_for(std)), strict=True):
        each = np.zeros(1, dtype=np.int64)
        tables = plant.tables(plant.nominal[None])
        how = {"taken": taken, "accuracy": accuracy}
        exact.append(simulate(tables, each, start, each, commands, 0, DT, **how)[0])
    assert (np.abs(exact[1] - exact[0]) <= np.maximum(std[:, None] / 3.0, 2e-5)).all()
    assert steps[1] < steps[0]


@pytest.mark.parametrize(
    ("std", "times"), [([1e-9, 1e-3], 1.0), ([3e-5, 3.0], 5.0), ([1.0, 1.5e-3], 5.0), ([1, 1], 10)]
)
def test_the_most_exact_reading_says_how_coarse_steps_may_be(std, times):
    """A thirtieth of its noise, against tolerances of 2e-7 and 1e-5, and no more than tenfold."""
    assert accuracy_for(np.array(std)) == pytest.approx(times)


def test_a_motion_that_runs_away_is_lost_from_there_on_and_alone():
    plant = pendulum()
    push = EffectInstance(CATALOGUE["constant_force"], "pendulum")
    forces = np.array([[0.0], [2e4], [0.5]])
    tables = plant.tables(np.tile(plant.nominal, (3, 1)), [push], [forces])
    starts, each = np.tile(START, (3, 1)), np.arange(3)
    y = simulate(tables, each, starts, np.zeros(3, int), PULSES[None, :, None], 0, DT)
    lost = np.isnan(y[1]).any(axis=0)
    assert not lost[0]
    assert lost[-1]
    assert (np.diff(lost.astype(int)) >= 0).all()
    assert np.isnan(y[1][:, lost]).all()
    for s in (0, 2):
        alone = plant.tables(plant.nominal[None], [push], [forces[s : s + 1]])
        zero = np.zeros(1, int)
        one = simulate(alone, zero, starts[:1], zero, PULSES[None, :, None], 0, DT)
        np.testing.assert_array_equal(y[s], one[0])


@pytest.mark.parametrize("plant", [pendulum(), double_pendulum()], ids=["one joint", "two"])
def test_no_motion_is_lost_where_dry_friction_turns_over(plant):
    """A step that ends at rest must not be cut for ever to one that is hardly shorter."""
    rng, friction = np.random.default_rng(0), CATALOGUE["coulomb_friction"]
    sticky = plant.having([(EffectInstance(friction, plant.layout.joints[0]), [1.0, 3e-3])])
    starts = rng.normal(0.0, 1.0, (1000, len(plant.layout.states)))
    commands = rng.uniform(-2.0, 2.0, (1000, 1, len(plant.layout.inputs)))
    commands = commands * np.sin(np.linspace(0.0, 6.0, 200))[None, :, None]
    tables, zero = sticky.tables(sticky.nominal[None]), np.zeros(1000, int)
    y = sticky.run(tables, zero, starts, np.arange(1000), commands, 0, 5e-3, accuracy=10.0)
    assert np.isfinite(y).all()


def test_a_batch_of_systems_equals_a_loop_over_them():
    rng = np.random.default_rng(0)
    plant = cart_pole()
    actives = [
        EffectInstance(CATALOGUE["coulomb_friction"], "cart"),
        EffectInstance(CATALOGUE["actuator_delay"], "actuator"),
        EffectInstance(CATALOGUE["body_mass"], "pole"),
        EffectInstance(CATALOGUE["sensor_delay"], "pole_angle"),
    ]
    values = [
        np.column_stack([rng.uniform(0, 0.5, 3), np.full(3, 1e-2)]),
        rng.uniform(0, 0.05, (3, 1)),
        rng.uniform(0, 0.2, (3, 1)),
        rng.uniform(0, 0.05, (3, 1)),
    ]
    parameters = plant.nominal * rng.uniform(0.9, 1.1, (3, len(plant.nominal)))
    tables = plant.tables(parameters, actives, values)
    starts, commands = rng.normal(size=(5, 4)), rng.uniform(-5, 5, (2, 13, 1))
    system, window = np.array([2, 0, 1, 1, 2]), np.array([1, 0, 0, 1, 1])
    together = simulate(tables, system, starts, window, commands, 3, DT)
    assert together.shape == (5, 4, 10)
    for b, (s, n) in enumerate(zip(system, window, strict=True)):
        alone = plant.tables(parameters[[s]], actives, [value[[s]] for value in values])
        zero = np.zeros(1, int)
        y = simulate(alone, zero, starts[[b]], zero, commands[[n]], 3, DT)
        np.testing.assert_array_equal(together[b], y[0])


@pytest.mark.parametrize(
    "name", [name for name in ORDINARY if CATALOGUE[name].targets(double_pendulum().layout)]
)
def test_a_motion_is_the_same_beside_any_others(name):
    """To the last bit: what the lanes next to it do, and how many there are, is nothing to it."""
    plant, rng = double_pendulum(), np.random.default_rng(3)
    effect, dahl = CATALOGUE[name], CATALOGUE["dahl_friction"]
    target = effect.targets(plant.layout)[-1]
    values = np.array(ORDINARY[name]) * (1.0 + 0.02 * np.arange(4))[:, None]
    effects = [EffectInstance(effect, target)]
    both = [values]
    if name != dahl.name:
        effects.append(EffectInstance(dahl, plant.layout.joints[0]))
        both.append(np.array([[0.0, 0.1], [0.05, 0.1], [0.05, 0.2], [0.1, 0.1]]))
    tables = plant.tables(np.tile(plant.nominal, (4, 1)), effects, both)
    system, window = rng.integers(0, 4, 11), rng.integers(0, 3, 11)
    start, commands = rng.normal(size=(11, 4)), rng.normal(size=(3, 15, 2))
    start[4] = [0.0, 9e3, 0.0, -9e3]  # this one is lost

    def run(some: np.ndarray) -> np.ndarray:
        return simulate(tables, system[some], start[some], window[some], commands, 3, DT)

    whole = run(np.arange(11))
    assert np.isnan(whole[4]).any()
    for some in (np.arange(11)[::-1], np.array([5]), rng.permutation(11)[:9]):
        np.testing.assert_array_equal(run(some), whole[some])


@pytest.mark.parametrize("name", ["back_emf", "elastic_joint", "joint_backlash", "dahl_friction"])
def test_a_memory_that_is_lost_leaves_that_of_others(name):
    """As where a fit tries sizes beyond all numbers."""
    plant, zeros = pendulum(), np.zeros(8, int)
    effect = EffectInstance(CATALOGUE[name], CATALOGUE[name].targets(plant.layout)[0])
    values = np.tile(ORDINARY[name], (2, 1))
    values[1] *= 1e200
    tables = plant.tables(np.tile(plant.nominal, (2, 1)), [effect], [values])
    starts, commands = np.tile(START, (8, 1)), PULSES[None, :, None]
    alone = simulate(tables, zeros, starts, zeros, commands, 0, DT)
    beside = simulate(tables, np.arange(8) % 2, starts, zeros, commands, 0, DT)
    np.testing.assert_array_equal(beside[::2], alone[::2])


def test_an_actuator_remembers_what_came_before_the_start():
    memory = ("actuator_lag", [0.05]), ("actuator_delay", [0.033]), ("backlash", [0.2])
    plant = having(*((name, "actuator", values) for name, values in memory))
    tables, zero = plant.tables(plant.nominal[None]), np.zeros(1, int)
    commands = PULSES[None, :, None]
    whole = simulate(tables, zero, START[None], zero, commands, 0, DT)
    for lead in (6, 7, 12):
        rest = simulate(tables, zero, whole[:, :, lead].copy(), zero, commands, lead, DT)
        np.testing.assert_allclose(rest, whole[:, :, lead:], **CLOSE)
        forgotten = simulate(
            tables, zero, whole[:, :, lead].copy(), zero, commands[:, lead:], 0, DT
        )
        assert np.abs(forgotten - rest).max() > 1e-3
