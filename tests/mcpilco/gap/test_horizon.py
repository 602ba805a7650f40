"""How far machines that touch things are followed, in which timesteps, and with what noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import envs
from mcpilco.gap.data import GapProblem
from mcpilco.gap.horizon import followed
from mcpilco.gap.thresholds import DATA
from mcpilco.mjcf import MujocoPlant, plant_of
from mcpilco.plant import CATALOGUE, EffectInstance
from mcpilco.recordings import Recording
from tests.mcpilco.gap import machines
from tests.mcpilco.gap.pendulum import record
from tests.mcpilco.mjcf.mujoco.models import HOPPER, plant_of_text

NOISE = np.tile([2e-3, 4e-2], 5)
"""std of that of each reading [m or rad, m/s or rad/s]"""
FINE = HOPPER.replace('timestep="0.005"', 'timestep="0.00125"')
AIRBORNE = HOPPER.replace("/>", '><flag contact="disable"/></option>', 1)


def recorded(truth: MujocoPlant, noise: float = 1.0) -> list[Recording]:
    """Three recordings of 4 s, of commands that change every tenth of a second."""
    rng, made = np.random.default_rng(0), []
    for n in range(3):
        u = np.repeat(rng.uniform(-0.5, 0.5, (40, 2)), 5, axis=0)
        y = truth.simulate(truth.rest[None], u[None], 0.02)[0]
        y += noise * NOISE * rng.normal(size=y.shape)
        time, u = 0.02 * np.arange(len(y)), np.append(u, u[-1:], axis=0)
        made.append(Recording(f"{n}", time, y, u, truth.layout.states, truth.layout.inputs))
    return made


def problem_of(
    text: str, recordings: list[Recording], noise: dict[str, float] | None = None
) -> GapProblem:
    """The problem of a hopper, before it was looked at how far it can be followed."""
    return GapProblem.of(plant_of_text(text), recordings, 0.01, (), noise or {})


@pytest.fixture(scope="module")
def hopper() -> GapProblem:
    return problem_of(HOPPER, recorded(plant_of_text(FINE)))


@pytest.fixture(scope="module")
def hopping(hopper: GapProblem) -> GapProblem:
    """As far as it can be followed."""
    return followed(hopper, {})


@pytest.fixture(scope="module")
def airborne() -> GapProblem:
    """A hopper that touches nothing, as far as it can be followed."""
    return followed(problem_of(AIRBORNE, recorded(plant_of_text(AIRBORNE))), {})


def test_noise_is_what_the_plant_leaves_where_impacts_are_as_sudden(
    hopper: GapProblem, hopping: GapProblem
) -> None:
    seen = hopper.std / NOISE
    left = hopping.std / NOISE
    assert seen.max() > 5.0  # impacts count as noise where a smooth curve is all that is known
    assert np.all((left > 0.7) & (left < 0.5 * seen.max()))
    assert np.median(left) < 1.6


@pytest.mark.slow
def test_noise_that_is_known_stays(airborne: GapProblem) -> None:
    known = {"knee_velocity": 0.5}
    problem = problem_of(AIRBORNE, list(airborne.recordings), known)
    found = followed(problem, known)
    x = problem.plant.layout.states.index("knee_velocity")
    assert problem.std[x] == 0.5
    assert 0.5 <= found.std[x] < 0.51  # but for what the timesteps do
    assert airborne.std[x] < 0.3


@pytest.mark.slow
def test_recordings_without_noise_keep_some() -> None:
    """Of a simulation by the same timesteps nothing is left over."""
    problem = problem_of(HOPPER, recorded(plant_of_text(HOPPER), noise=0.0))
    found, every = followed(problem, {}), np.concatenate([r.states for r in problem.recordings])
    assert np.all(found.std >= np.minimum(problem.std, DATA.least_noise * every.std(axis=0)))


def test_windows_end_where_motions_do_not_answer_smoothly_to_their_starts(
    hopping: GapProblem, airborne: GapProblem
) -> None:
    assert airborne.window_s > 0.7 * DATA.window_s
    assert DATA.shortest_s <= hopping.window_s < 0.5 * airborne.window_s


def test_equations_are_followed_as_they_are() -> None:
    recordings = [record(np.random.default_rng(0), lambda q, v: 0.0, 0)]
    problem = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    assert followed(problem, {}) is problem


@pytest.mark.parametrize("name", ["sensor_lag", "sensor_delay"])
def test_what_is_quicker_than_a_timestep_is_no_effect(hopping: GapProblem, name: str) -> None:
    """An integrator is as late by itself."""
    step = hopping.plant.finely(hopping.finer).timestep_s
    model = hopping.model(hopping.windows()[:3])
    late = EffectInstance(CATALOGUE[name], "knee_position")
    for part, meant in ((0.3, False), (3.0, True)):
        larger, theta = model.grown(np.zeros(model.nuisances), late, [part * step])
        assert larger.plausible(theta) == meant


def test_by_equations_an_effect_may_be_quick() -> None:
    recordings = [record(np.random.default_rng(0), lambda q, v: 0.0, 0)]
    problem = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    model = problem.model(problem.windows()[:3])
    late = EffectInstance(CATALOGUE["sensor_delay"], "angle")
    larger, theta = model.grown(np.zeros(model.nuisances), late, [1e-4])
    assert larger.plausible(theta)


@pytest.mark.parametrize(
    ("late_s", "in_steps", "known"),
    [(0.004, 1.0, False), (0.006, 1.0, True), (0.004, 0.0, True)],
)
def test_equations_know_of_nothing_quicker_than_the_timestep_of_the_simulator_that_they_stand_for(
    late_s: float, in_steps: float, known: bool, tmp_path: Path
) -> None:
    """A machine's delay may be shorter than the timestep of the file that says what it weighs."""
    path = tmp_path / "lever.xml"
    path.write_text(
        '<mujoco><option timestep="0.005"/><worldbody><body name="rod"><joint name="hinge" '
        'axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02"/></body>'
        '</worldbody><actuator><motor name="motor" joint="hinge"/></actuator></mujoco>'
    )
    plant = plant_of(path).in_steps(in_steps)
    u = np.repeat(np.random.default_rng(0).uniform(-0.5, 0.5, (20, 1)), 10, axis=0)
    y = plant.simulate(plant.rest[None], u[None], 0.02)[0]
    names = plant.layout.states, plant.layout.inputs
    log = Recording("log", 0.02 * np.arange(len(y)), y, np.append(u, u[-1:], axis=0), *names)
    problem = GapProblem.of(plant, [log], 0.01, (), {})
    model = problem.model(problem.windows())
    late = EffectInstance(CATALOGUE["actuator_lag"], plant.layout.actuator(0))
    larger, theta = model.grown(np.zeros(model.nuisances), late, [late_s])
    assert larger.plausible(theta) == known


@pytest.mark.parametrize("machine", machines.NAMES)
def test_how_a_machine_turns_between_samples_far_apart_is_no_noise(machine: str) -> None:
    plants = {"pendulum": "mcpilco/Pendulum-v0", "cart_pole": "mcpilco/CartPoleSwingUp-v0"}
    measured = machines.recorded(machine, 0, dt=0.1)
    problem = GapProblem.of(envs.PLANTS[plants[machine]](), measured, 0.01, (), {})
    np.testing.assert_allclose(followed(problem, {}).std, machines.NOISE[machine], rtol=0.25)
    name = problem.plant.layout.states[1]
    known = GapProblem.of(problem.plant, measured, 0.01, (), {name: 0.5})
    assert followed(known, {name: 0.5}).std[1] == 0.5
