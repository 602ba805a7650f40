"""Simulations of windows, and how they answer to parameters and forces."""

from __future__ import annotations

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import envs
from mcpilco.gap.data import GapProblem
from mcpilco.gap.disturbance import Disturbance
from mcpilco.gap.fit import Fit
from mcpilco.gap.horizon import followed
from mcpilco.gap.plant_model import PlantModel
from mcpilco.gap.sensitivities import LOST, impulse_responses, linearise, residual, run
from mcpilco.plant import CATALOGUE, EffectInstance
from mcpilco.recordings import Recording
from mcpilco.typing import InputError
from tests.mcpilco.gap.lagging import active
from tests.mcpilco.gap.lagging import problem as problem_of
from tests.mcpilco.gap.pendulum import record
from tests.mcpilco.mjcf.mujoco.models import HOPPER, plant_of_text

FALLING = HOPPER.replace('integrator="implicitfast"/>', '><flag contact="disable"/></option>')


def hopping(text: str, truth: str, seconds: float = 4.0) -> GapProblem:
    """A hopper that MuJoCo simulates, and recordings of another one with noise of 2e-3."""
    plant, rng = plant_of_text(text), np.random.default_rng(0)
    recordings = []
    for n in range(3):
        u = np.repeat(rng.uniform(-0.5, 0.5, (round(seconds / 0.1), 2)), 5, axis=0)
        y = plant_of_text(truth).simulate(plant.rest[None], u[None], 0.02)[0]
        y += rng.normal(0.0, 2e-3, y.shape)
        time, u = 0.02 * np.arange(len(y)), np.append(u, u[-1:], axis=0)
        recordings.append(Recording(f"{n}", time, y, u, plant.layout.states, plant.layout.inputs))
    return followed(GapProblem.of(plant, recordings, 0.01, (), {}), {})


@pytest.mark.slow
def test_responses_to_pulses_are_those_to_forces_along_the_whole_motion() -> None:
    """A force that is held all the time is the sum of its pulses, behind a sensor that is late."""
    problem = hopping(FALLING, FALLING)
    windows = problem.windows()[:3]
    late = EffectInstance(CATALOGUE["sensor_delay"], "pitch_position")
    push = EffectInstance(CATALOGUE["constant_force"], "hip")
    model = problem.model(windows)
    model, theta = model.grown(np.zeros(model.nuisances), late, [0.03])
    (found,) = impulse_responses(model, windows, theta, windows.guess, [3], 3)
    pushed, more = model.grown(theta, push, [1e-4])
    with_push, without = (
        run(each, windows, at[None], windows.guess[None])[0]
        for each, at in ((pushed, more), (model, theta))
    )
    change = np.where(windows.measured, (with_push - without) / 1e-4, 0.0)
    change = (change / windows.std[:, None]).reshape(3, -1)
    np.testing.assert_allclose(found.sum(axis=2), change, atol=5e-3 * np.abs(change).max())


def test_columns_of_a_nearby_model_are_taken_over() -> None:
    recordings = [record(np.random.default_rng(0), lambda q, v: 0.0, 0)]
    problem = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    windows = problem.windows()[:3]
    model = problem.model(windows)
    theta = np.zeros(model.nuisances)
    spring = EffectInstance(CATALOGUE["spring"], "pendulum")
    larger, more = model.grown(theta, spring, [0.1])
    near = linearise(model, windows, theta, windows.guess)
    found = linearise(larger, windows, more, windows.guess, near=near)
    whole = linearise(larger, windows, more, windows.guess)
    np.testing.assert_array_equal(found.Jp[..., -1], whole.Jp[..., -1])
    np.testing.assert_array_equal(found.Jp[..., :-1], near.Jp)
    np.testing.assert_array_equal(found.r, whole.r)


def test_columns_of_what_a_prior_holds_are_taken_over_where_the_others_are_made_anew() -> None:
    """A gain that is freed is held by none."""
    recordings = [record(np.random.default_rng(0), lambda q, v: 0.0, 0)]
    problem = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    windows = problem.windows()[:3]
    model, theta = problem.model(windows), np.zeros(problem.model(windows).nuisances)
    gain = EffectInstance(CATALOGUE["actuator_gain"], "actuator")
    spring = EffectInstance(CATALOGUE["spring"], "pendulum")
    model, theta = model.having(gain).grown(theta, spring, [0.1])
    near = linearise(model, windows, theta, windows.guess)
    there = theta + 0.05
    found = linearise(model, windows, there, windows.guess, near, anew=True)
    whole = linearise(model, windows, there, windows.guess)
    free = [list(model.priors).index("torque_gain"), len(theta) - 1]
    held = np.setdiff1d(np.arange(len(theta)), free)
    np.testing.assert_array_equal(found.Jp[..., held], near.Jp[..., held])
    np.testing.assert_array_equal(found.Jp[..., free], whole.Jp[..., free])
    np.testing.assert_array_equal(found.Jx, whole.Jx)
    assert (whole.Jp[..., free] != near.Jp[..., free]).any()


def test_samples_that_one_simulation_loses_leave_what_was_whitened_with_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Weights of random forces mix the samples of a window: what is lost must not enter them."""
    recordings = [record(np.random.default_rng(0), lambda q, v: 0.0, 0)]
    problem = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    windows = problem.windows()[:3]
    model = problem.model(windows)
    fit = Fit(model, np.zeros(model.nuisances), windows.guess, np.ones(3))
    forces, known = Disturbance.of(fit, windows), windows.y.shape[2] - 5
    weighed = forces.whitened(replace(forces.evidence(fit), std=np.full(1, 0.1)))
    sensitivities = importlib.import_module("mcpilco.gap.sensitivities")

    def losing(*given: Any) -> np.ndarray:
        y = run(*given)
        y[-1, 1, :, known:] = np.nan
        return y

    plain = linearise(model, windows, fit.theta, fit.x0)
    monkeypatch.setattr(sensitivities, "run", losing)
    found = linearise(model, weighed, fit.theta, fit.x0)
    columns = plain.Jp.copy()
    columns[1].reshape(*windows.y.shape[1:], -1)[:, known:] = 0.0
    assert weighed.whitening is not None
    expected = weighed.whitening(columns.transpose(2, 0, 1)).transpose(1, 2, 0)
    np.testing.assert_allclose(found.Jp, expected, atol=1e-9 * np.abs(expected).max())
    y = losing(model, windows, fit.theta[None], fit.x0[None])[0]
    missed = residual(weighed, y).reshape(y.shape)
    assert (missed[1, 0, known:] == LOST).all()  # the angle, which alone was measured
    assert np.abs(missed[1, :, :known]).max() < 0.1 * LOST


@pytest.mark.slow
def test_motions_are_compared_in_timesteps_that_do_less_than_the_noise() -> None:
    coarse = hopping(HOPPER.replace('timestep="0.005"', 'timestep="0.02"'), HOPPER)
    assert coarse.finer > 1
    windows = coarse.windows()[:4]
    model = coarse.model(windows)
    theta = np.zeros((1, model.nuisances))
    rough, compared = (
        run(replace(model, finer=times), windows, theta, windows.guess[None])
        for times in (1, model.finer)
    )
    fine = coarse.plant.finely(27)
    least = run(replace(model, plant=fine, finer=1), windows, theta, windows.guess[None])
    assert np.nanmedian(np.abs(compared - least)) < 0.5 * np.nanmedian(np.abs(rough - least))


def test_the_beginning_of_windows_is_simulated_like_the_whole() -> None:
    recordings = [record(np.random.default_rng(0), lambda q, v: 0.0, 0)]
    problem = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    windows = problem.windows()[:3]
    model, first = problem.model(windows), windows.part(0, 12)
    theta, x0 = np.zeros((1, model.nuisances)), windows.guess[None]
    assert first.y.shape[2] == 12
    np.testing.assert_array_equal(first.y, windows.y[:, :, :12])
    whole = run(model, windows, theta, x0)
    np.testing.assert_array_equal(run(model, first, theta, x0), whole[..., :12])


def test_a_model_that_flies_apart_is_refused_in_one_sentence(caplog) -> None:
    stiff = HOPPER.replace('<joint name="hip"', '<joint name="hip" stiffness="1e13"')
    with pytest.raises(InputError, match=r"it flies apart in most windows; choose a shorter"):
        hopping(stiff, HOPPER)
    assert caplog.records == []  # MuJoCo's own warnings, thousands of them


def test_a_joint_that_sticks_answers_to_a_force_as_one_that_moves() -> None:
    """On the machine it may move; beside its friction it hardly gives way to a small force."""
    friction = active("coulomb_friction", "cart"), (0.5, 2e-3)
    windows = problem_of(envs.PLANTS["mcpilco/CartPoleSwingUp-v0"](), [friction]).windows()[:4]
    still = replace(windows, commands=0.0 * windows.commands)
    free = problem_of(envs.PLANTS["mcpilco/CartPoleSwingUp-v0"](), []).model(windows)
    stuck, theta = free.grown(np.zeros(free.nuisances), *friction)

    def answer(model: PlantModel, theta: np.ndarray, unstuck: bool) -> float:
        at = model, still, theta, np.zeros((4, 4))
        return float(np.abs(impulse_responses(*at, [0], 3, unstuck)[0]).max())

    moves = answer(free, np.zeros(free.nuisances), False)
    assert answer(stuck, theta, False) < 0.05 * moves
    assert 0.3 * moves < answer(stuck, theta, True) < moves
