"""Fits to windows, their initial states, and the clock of the commands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import envs
from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.fit import (
    Fit,
    fit_initial_states,
    fit_model,
    given_way,
    initial_state_step,
    likeliest,
    misfits,
)
from mcpilco.gap.sensitivities import lean, residuals_at
from mcpilco.gap.thresholds import FIT
from mcpilco.mjcf import MujocoPlant
from mcpilco.plant import CATALOGUE, EffectInstance, Plant
from mcpilco.recordings import Recording, possible_origins
from tests.mcpilco.gap.pendulum import record
from tests.mcpilco.gap.test_sensitivities import FALLING, hopping
from tests.mcpilco.mjcf.mujoco.models import HOPPER


def test_initial_states_are_sought_where_a_sensor_that_is_off_would_have_measured_them() -> None:
    """An angle of ten turns that is read 10 % short is a whole turn away from what is read."""
    turned = record(np.random.default_rng(0), lambda q, v: 0.0, 0)
    turned.states[:, 0] = 0.9 * (turned.states[:, 0] + 20.0 * np.pi) + 0.5
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    problem = GapProblem.of(plant, [turned], 0.01, (), {"angle": 2e-3})
    windows = problem.windows()
    nominal = problem.model(windows)
    model, theta = nominal, np.zeros(nominal.nuisances)
    for name, value in (("sensor_scale", 0.9), ("sensor_offset", 0.5)):
        model, theta = model.grown(theta, EffectInstance(CATALOGUE[name], "angle"), [value])
    misfit = (
        misfits(model, windows, theta, fit_initial_states(model, windows, theta)) / windows.samples
    )
    assert misfit.max() < 2.0
    as_read, as_it_was = (
        np.median(misfits(model, windows, theta, begin) / windows.samples)
        for begin in (windows.guess, model.invert_sensors(theta, windows.guess))
    )
    assert as_it_was < 0.1 * as_read


DT = 0.02


def stamped(machine: Plant, by_clock: bool) -> Recording:
    """Ten seconds of a pendulum under steps; the stamps of the samples stray by 3 ms."""
    rng = np.random.default_rng(0)
    torque = np.repeat(rng.uniform(-1.2, 1.2, 50), 10)
    late = rng.uniform(0.0, 0.15, len(torque))  # part of a step by which the command is late
    mixed = torque - late * np.diff(torque, prepend=torque[0])
    sent = torque if by_clock else mixed
    states = machine.simulate(np.array([[0.3, 0.0]]), sent[None, :-1, None], DT)[0]
    states += rng.standard_normal(states.shape) * [2e-3, np.nan]
    time, layout = DT * np.arange(len(torque)), machine.layout
    found = Recording("a", time, states, mixed[:, None], layout.states, layout.inputs)
    return replace(found, by_clock=torque[:, None])


def problems_of(machine: Plant, by_clock: bool) -> list[GapProblem]:
    origins = possible_origins(envs.PLANTS["mcpilco/Pendulum-v0"](), [stamped(machine, by_clock)])
    return [GapProblem.of(plant, recordings, 0.01, (), {}) for plant, recordings in origins]


@pytest.mark.parametrize("by_clock", [True, False])
def test_the_motion_tells_when_commands_went_out(by_clock: bool) -> None:
    sent = problems_of(envs.PLANTS["mcpilco/Pendulum-v0"](), by_clock)
    assert likeliest(sent) is sent[not by_clock]


def test_a_model_that_fits_tells_what_a_missing_effect_hides() -> None:
    friction = EffectInstance(CATALOGUE["coulomb_friction"], "pendulum")
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    sent = problems_of(plant.having([(friction, (0.15, 2e-3))]), by_clock=False)
    nominal = sent[0].model(sent[0].windows())
    model, theta = nominal.grown(np.zeros(nominal.nuisances), friction, (0.15, 2e-3))
    known = Fit(model, theta, np.zeros((0, 2)), np.zeros(0))
    assert likeliest(sent, known) is sent[1]


def test_a_linear_form_that_is_kept_leads_to_the_same_fit(monkeypatch) -> None:
    recording = record(np.random.default_rng(0), lambda q, v: -0.1 * q, 0)
    problem = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), [recording], 0.01, (), {})
    windows = problem.windows()[:6]
    nominal, spring = problem.model(windows), EffectInstance(CATALOGUE["spring"], "pendulum")
    model, theta = nominal.grown(np.zeros(nominal.nuisances), spring, [0.02])
    begun, taken = fit_initial_states(model, windows, theta), []
    for foretold in (np.inf, FIT.foretold):  # never kept, and where it foretells a step
        monkeypatch.setattr("mcpilco.gap.fit.FIT", replace(FIT, foretold=foretold))
        before = int(model.budget.used[0])
        taken.append((fit_model(model, windows, theta, begun), model.budget.used[0] - before))
    (fresh, steps), (kept, fewer) = taken
    assert fresh.theta[-1] == pytest.approx(0.1, rel=0.2)
    assert kept.theta[-1] == pytest.approx(fresh.theta[-1], rel=1e-3)
    assert kept.chi2 == pytest.approx(fresh.chi2, rel=1e-3)
    assert fewer < steps


@pytest.mark.slow
def test_steps_of_initial_states_tell_how_the_motion_answers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where a simulation is dear fewer of them lead to starts as good."""
    problem = hopping(FALLING, FALLING)
    windows = problem.windows()
    model = problem.model(windows)
    theta, taken, missed = np.zeros(model.nuisances), [], []
    for dear in (False, True):
        monkeypatch.setattr(MujocoPlant, "costly", dear)
        before = int(problem.budget.used[0])
        x0 = fit_initial_states(model, windows, theta, windows.guess)
        taken.append(int(problem.budget.used[0]) - before)
        missed.append(misfits(model, windows, theta, x0).sum())
    assert missed[1] < 1.05 * missed[0]
    assert taken[1] < 0.8 * taken[0]


def test_motions_on_a_ground_that_is_higher_may_begin_where_they_were_measured() -> None:
    """Fitted without the ground they begin lower, from where no linear step leads back."""
    h = 0.02
    problem = hopping(HOPPER, HOPPER.replace('name="floor"', f'name="floor" pos="0 0 {h}"'))
    windows = problem.windows()[::2]
    model, theta = problem.model(windows), np.zeros(problem.model(windows).nuisances)
    low = windows.guess - h * (np.arange(windows.guess.shape[1]) == 2)
    Jx = lean(model, windows, theta, low).Jx
    ground = EffectInstance(CATALOGUE["ground_height"], "ground")
    model, theta = model.grown(theta, ground, [h])
    found, missed = given_way(model, windows, theta, low, Jx)
    np.testing.assert_array_equal(missed, misfits(model, windows, theta, found))
    step = initial_state_step(Jx, residuals_at(model, windows, theta, low))
    others = [misfits(model, windows, theta, x0) for x0 in (low, low + step)]
    assert (missed <= np.min(others, axis=0)).all()
    assert np.median(missed) < 0.5 * np.median(np.min(others, axis=0))


def test_a_fit_is_linearised_once_on_the_same_windows(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    _, windows, fit = lagging
    lin = fit.linearised(windows)
    assert fit.linearised(windows) is lin
    few = windows[:3]
    np.testing.assert_allclose(fit.at(np.arange(3)).linearised(few).Jp, lin.Jp[:3], rtol=1e-9)
    assert replace(fit, theta=fit.theta + 0.1).linearised(windows) is not lin
