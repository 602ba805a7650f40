"""How the effects are scored that a fit lacks."""

from __future__ import annotations

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import envs
from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.disturbance import Disturbance
from mcpilco.gap.fit import Fit
from mcpilco.gap.screen import screen
from mcpilco.gap.sensitivities import linearise
from mcpilco.gap.thresholds import SCREEN, SEARCH
from tests.mcpilco.gap.lagging import active, fitted, problem


def test_an_effect_that_parameters_imitate_only_far_beyond_their_priors_is_promising() -> None:
    """Masses and length together can do what a center of mass does, each more than 10 % off."""
    center = active("center_of_mass", "pole")
    known = problem(envs.PLANTS["mcpilco/CartPoleSwingUp-v0"](), [(center, (-0.05,))])
    windows = known.windows()
    model = known.model(windows)
    null = fitted(model, windows, np.zeros(model.nuisances))
    assert np.median(null.by_window / windows.samples) < 1.2
    assert np.abs(null.theta).max() > 0.05
    lin = linearise(model, windows, null.theta, null.x0)
    (score,) = screen(null, lin, windows, [center])
    assert score.gain > SEARCH.promising


def test_a_window_that_is_moved_far_more_than_the_others_does_not_hide_an_effect(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Near an unstable rest a signature is as large as it is wrong."""
    _, windows, null = lagging
    friction = active("coulomb_friction", "pendulum")
    lin = linearise(null.model, windows, null.theta, null.x0)
    (score, *_) = screen(null, lin, windows, [friction])
    module = importlib.import_module("mcpilco.gap.screen")
    told = module.signatures

    def wild(*args: Any) -> list[np.ndarray]:
        columns = told(*args)
        for column in columns:
            column[0] *= -100.0
        return columns

    monkeypatch.setattr(module, "signatures", wild)
    (wildly, *_) = screen(null, lin, windows, [friction])
    assert wildly.gain > 0.3 * score.gain
    monkeypatch.setattr(module, "SCREEN", replace(SCREEN, influence=np.inf))
    (blindly, *_) = screen(null, lin, windows, [friction])
    assert blindly.gain < 0.03 * score.gain


def test_effects_are_scored_beside_two_that_do_the_same(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The armature of a lone link is an inertia of its body."""
    _, windows, null = lagging
    model, theta = null.model, null.theta
    for effect in ("armature", "body_inertia"):
        model, theta = model.grown(theta, active(effect, "pendulum"), [0.01])
    lin = linearise(model, windows, theta, null.x0)
    lin.Jp[:, :, -2:] = 1e5 * lin.Jp[:, :, -2:-1]
    fit, friction = replace(null, model=model, theta=theta), active("coulomb_friction", "pendulum")
    alike = screen(fit, lin, windows, [friction])
    assert all(np.isfinite(score.gain) for score in alike)
    module = importlib.import_module("mcpilco.gap.screen")
    monkeypatch.setattr(module, "SCREEN", replace(SCREEN, rounding=0.0))
    with pytest.raises(np.linalg.LinAlgError):
        screen(fit, lin, windows, [friction])


def test_where_a_simulation_is_dear_the_same_effects_promise_most_after_fewer_steps(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    known, windows, null = lagging
    names = "position_ripple", "coulomb_friction", "viscous_friction", "spring"
    candidates = [active("actuator_lag", "actuator"), *(active(n, "pendulum") for n in names)]
    lin, pulses = linearise(null.model, windows, null.theta, null.x0), Disturbance.of(null, windows)
    module = importlib.import_module("mcpilco.gap.screen")
    monkeypatch.setattr(module, "SCREEN", replace(SCREEN, checked=1))
    taken, scores = [], []
    for given in (None, pulses):
        before = int(known.budget.used[0])
        scores.append(screen(null, lin, windows, candidates, pulses=given))
        taken.append(int(known.budget.used[0]) - before)
    whole, first = scores
    assert first[0].instance == whole[0].instance
    assert first[0].gain == whole[0].gain
    assert {score.instance for score in first} == set(candidates)
    assert taken[1] < 0.5 * taken[0]


def test_of_an_effect_of_many_shapes_those_are_simulated_that_promise_most() -> None:
    ripple = active("position_ripple", "pendulum")
    known = problem(envs.PLANTS["mcpilco/Pendulum-v0"](), [(ripple, (0.02, 0.03, 12.0))])
    windows = known.windows()
    model = known.model(windows)
    null = fitted(model, windows, np.zeros(model.nuisances))
    lin, pulses = linearise(model, windows, null.theta, null.x0), Disturbance.of(null, windows)
    best, taken = [], []
    for given in (None, pulses):
        before = int(known.budget.used[0])
        best.append(screen(null, lin, windows, [ripple], pulses=given)[0])
        taken.append(int(known.budget.used[0]) - before)
    assert taken[1] < 0.3 * taken[0]
    assert best[1].gain > 0.9 * best[0].gain
    assert best[1].start[2] == pytest.approx(12.0, abs=1.0)


def test_an_effect_without_a_usual_size_is_left_out_where_a_simulation_is_dear(
    lagging: tuple[GapProblem, Windows, Fit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is relative to the mass or the length of a body that has none."""
    _, windows, null = lagging
    inertia, friction = (active(n, "pendulum") for n in ("body_inertia", "coulomb_friction"))
    monkeypatch.setattr(type(inertia.effect), "probes", lambda *_: [])
    lin, pulses = linearise(null.model, windows, null.theta, null.x0), Disturbance.of(null, windows)
    scores = screen(null, lin, windows, [inertia, friction], pulses=pulses)
    assert {score.instance for score in scores} == {friction}
