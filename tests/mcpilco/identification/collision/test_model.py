"""Laws of the models of currents, on an arm whose truth they were not given."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from mcpilco.identification.collision import (
    CurrentConfig,
    CurrentFeatures,
    condition_currents,
    current_regressors,
    fit_currents,
    inputs_of,
    quiet,
)
from mcpilco.typing import InputError
from tests.mcpilco.identification.collision.free_arm import DT, SMALL, body, fitted, samples


def rmse(kind: str, at_rest: bool) -> np.ndarray:
    """Of each joint, on samples that nothing was fitted to."""
    model, _ = fitted(kind)
    test = samples(2)
    rows = model.quiet(test) == at_rest
    error = np.where(rows, test.i - model.mean(test), 0.0)
    return np.sqrt((error**2).sum(axis=0) / rows.sum(axis=0))


@pytest.mark.one_in(3)
@pytest.mark.parametrize("kind", ["PP", "SP", "FC"])
@pytest.mark.parametrize("what", ["hard", pytest.param("smooth", marks=pytest.mark.slow)])
def test_the_fast_form_is_the_posterior(kind, what):
    model, _ = fitted(kind, what)
    test = samples(2)[400:500]
    own, their = (inputs_of(s, model.features, model.config) for s in (model.train, test))
    mean, std = model.mean(test), model.std(test)
    for j in (0, 4):
        y = torch.from_numpy(model.train.i[:, j : j + 1])
        posterior = model.gps[j].condition(current_regressors(model.train, own, j), y)
        expected, variance = posterior.mean_and_variance(current_regressors(test, their, j))
        np.testing.assert_allclose(mean[:, j], expected[:, 0].detach().numpy(), atol=1e-8)
        noise = model.predictors[j].noise_std
        np.testing.assert_allclose(
            std[:, j] ** 2 - noise**2, variance[:, 0].detach().numpy(), atol=1e-8
        )


@pytest.mark.slow
def test_compensated_friction_pays_at_rest_and_costs_nothing_in_motion():
    for kind in ("PP", "SP"):
        assert (rmse("FC", at_rest=True) < 0.25 * rmse(kind, at_rest=True)).all()
    assert (rmse("FC", at_rest=False) < 1.1 * rmse("PP", at_rest=False)).all()


def test_the_sign_of_noise_is_no_friction():
    features = CurrentFeatures(body(), 1e-2)
    dq = np.zeros((3, 6))
    dq[:, 0] = (0.009, -0.02, 0.02)
    phi = features(np.zeros((3, 6)), dq, np.zeros((3, 6)))
    assert phi[0][:, -1].tolist() == [0.0, -1.0, 1.0]
    assert features.names(0)[-1] == "base_dry"


def test_a_joint_feels_no_body_before_it():
    features = CurrentFeatures(body(), 1e-2)
    assert not any("column" in name or "forearm" in name for name in features.names(5))
    assert any("hand" in name for name in features.names(0))
    assert len(features.names(0)) > len(features.names(5))


def test_smooth_and_hard_gates_agree_far_from_the_edge():
    dq = np.array([0.0, 1e-3, 0.1, -1.0])
    np.testing.assert_allclose(quiet(dq, 1e-2, "smooth"), quiet(dq, 1e-2, "hard"), atol=0.011)


def test_a_fit_reports_of_itself():
    model, report = fitted("FC")
    assert len(report.evidence) == len(report.jitter) == 6
    assert 6 <= report.iterations <= 6 * SMALL["iterations"]
    assert report.unidentified == ()
    assert len(model.train) == SMALL["points"]


def test_more_evidence_for_compensated_friction():
    evidence = {kind: np.array(fitted(kind)[1].evidence) for kind in ("PP", "SP", "FC")}
    assert (evidence["FC"] > evidence["PP"]).all()
    assert (evidence["FC"] > evidence["SP"]).all()


def test_repeated_samples_are_told_by_their_jitter():
    """Without noise, equal rows have no factorisation but for the jitter."""
    model, report = fitted("PP")
    twice = model.train[np.repeat(np.arange(100), 2)]
    for gp in (gps := tuple(map(copy_of, model.gps))):
        gp.noise_floor.zero_()
        gp.noise_excess = 1e-12
    _, jitter = condition_currents(gps, twice, model.features, DT, model.config)
    assert min(jitter) > 1e-11 > max(report.jitter)


def copy_of(gp):
    import copy

    return copy.deepcopy(gp)


def test_motions_that_tell_little_are_said_to():
    still = samples(1, 30)
    held = np.where(np.arange(6) < 2, still.q, still.q[0])  # the wrist does not turn
    moved = dataclasses.replace(still, q=held)
    dq, ddq = moved.dq.copy(), moved.ddq.copy()
    config = CurrentConfig(kind="PP", **SMALL)
    _, report = fit_currents(dataclasses.replace(moved, dq=dq, ddq=ddq * 0.0), body(), DT, config)
    assert any(name.startswith("base: ") for name in report.unidentified)
    assert "move several joints at once" in report.warnings[0]


def changed(**arrays) -> None:
    fit_currents(dataclasses.replace(samples(1, 30), **arrays), body(), DT, CurrentConfig(**SMALL))


def test_data_that_cannot_teach_are_refused():
    good = samples(1, 30)
    dq, i, one = good.dq.copy(), good.i.copy(), np.arange(6) == 2
    with pytest.raises(InputError, match=r"elbow is slower than 0.01 rad/s in 100 %"):
        changed(dq=np.where(one, 0.0, dq))
    with pytest.raises(InputError, match=r"elbow rests \(slower than 0.01 rad/s\) in 0.0 %"):
        changed(dq=np.where(one, np.where(dq < 0, -1.0, 1.0), dq))
    with pytest.raises(InputError, match="the current of elbow is the same in all samples"):
        changed(i=np.where(one, 1.0, i))
    with pytest.raises(InputError, match="at least 500 samples to be learned from, got 300"):
        fit_currents(good[:300], body(), DT)
    half = np.repeat(np.arange(len(good) // 2), 2)
    with pytest.raises(InputError, match="50 % of the samples repeat"):
        fit_currents(good[half], body(), DT)


def test_a_parametric_model_needs_no_rests():
    good, one = samples(1, 30), np.arange(6) == 2
    dq = np.where(one, np.where(good.dq < 0, -1.0, 1.0), good.dq)
    model, _ = fit_currents(
        dataclasses.replace(good, dq=dq), body(), DT, CurrentConfig(kind="PP", **SMALL)
    )
    assert model.config.kind == "PP"
