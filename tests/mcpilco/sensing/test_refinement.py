"""Recordings smoothed by a model: the likeliest states, and nearer to the true ones."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.agent import MCPILCO
from mcpilco.config import EstimatorConfig
from mcpilco.data import Transitions
from mcpilco.dynamics.linearisation import Course
from mcpilco.sensing import refinement
from mcpilco.typing import InputError
from tests.mcpilco.sensing.test_perception import STEPS, hasty, learned

POSITIONS = "mcpilco/CartPoleSwingUpPositions-v0"


def test_of_a_linear_model_the_states_are_those_of_least_squares(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """All unknown states at once, by numpy: start, measurements and steps, each by its std."""
    task, T, X = MCPILCO("SumOfGaussians", POSITIONS, config=hasty()).task, 7, 4
    rng = np.random.default_rng(0)
    A, W = np.eye(X) + 0.3 * rng.normal(size=(T, X, X)), 0.1 * np.eye(X) + 0.05
    drift, noise_std = rng.normal(size=(T, X)), np.array([0.02, 0.5])

    def along(_, states, inputs):
        return Course(
            np.einsum("txy,ty->tx", A, states) + drift + inputs, A, np.broadcast_to(W, A.shape)
        )

    monkeypatch.setattr(refinement, "linearised_along", along)
    monkeypatch.setattr(refinement, "_within_steps", lambda *_: np.zeros(X))
    measured, inputs = rng.normal(size=(T + 1, 2)), rng.normal(size=(T, 1))
    states = rng.normal(size=(T + 1, X))
    found = refinement.refined(task, None, noise_std, measured, inputs, states)

    C, root = np.eye(X)[list(task.measured_states)], np.linalg.inv(np.linalg.cholesky(W))
    eye, rows, goals = np.eye((T + 1) * X).reshape(T + 1, X, -1), [], []
    for t in range(T + 1):
        rows.append((C @ eye[t]) / noise_std[:, None])
        goals.append(measured[t] / noise_std)
    for t in range(T):
        rows.append(root @ (eye[t + 1] - A[t] @ eye[t]))
        goals.append(root @ (drift[t] + inputs[t]))
    rows.append(eye[0] / np.array(task.start_std)[:, None])
    goals.append(np.array(task.start_mean) / np.array(task.start_std))
    wanted = np.linalg.lstsq(np.concatenate(rows), np.concatenate(goals), rcond=None)[0]
    np.testing.assert_allclose(found, wanted.reshape(T + 1, X), atol=1e-8)


@pytest.mark.parametrize("slope", [np.nan, np.inf, 1e9, 0.0])
def test_states_stay_where_a_model_leads_away_from_the_measurements(
    slope: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    task, T, X = MCPILCO("SumOfGaussians", POSITIONS, config=hasty()).task, 5, 4

    def along(_, states, inputs):
        return Course(states + 1e6, np.full((T, X, X), slope), np.zeros((T, X, X)))

    monkeypatch.setattr(refinement, "linearised_along", along)
    states = np.random.default_rng(0).normal(size=(T + 1, X))
    measured = states[:, list(task.measured_states)]
    given = np.full(2, 0.01), measured, np.zeros((T, 1)), states
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(refinement.refined(task, None, *given), states)


@pytest.mark.slow
def test_a_model_that_knows_the_forces_brings_velocities_nearer_to_the_true_ones() -> None:
    agent = learned(trials=3, refinements=0)
    records = [result.rollout for result in agent.results]
    rows = [Transitions(r.states[:-1], r.inputs, r.states[1:]) for r in records]
    truth = rows[0] + rows[1] + rows[2]
    model = MCPILCO.make_model(agent.config, agent.task)
    model.fit(truth)
    dynamics = model.dynamics(truth)
    errors = []
    for r in records:
        noise_std = agent.perception.noise_std
        known = r.observations, r.inputs, r.smoothed
        states = refinement.refined(agent.task, dynamics, noise_std, *known)
        errors.append([np.square(x - r.states)[:, [1, 3]].mean() for x in (r.smoothed, states)])
    before, after = np.sqrt(np.mean(errors, axis=0))
    assert after < 0.5 * before


@pytest.mark.slow
def test_an_agent_learns_from_states_smoothed_by_its_model() -> None:
    plain, anew = (learned(trials=2, refinements=count) for count in (0, 1))
    first = slice(STEPS)  # the first inputs: the same, whatever is learned from them
    np.testing.assert_array_equal(plain.transitions.inputs[first], anew.transitions.inputs[first])
    apart = plain.transitions.states[first] - anew.transitions.states[first]
    assert np.abs(apart).max() > 1e-4
    rows = anew.transitions
    np.testing.assert_array_equal(rows.states[1:STEPS], rows.next_states[: STEPS - 1])


def test_rows_whose_measurements_are_not_there_stay_as_they_are() -> None:
    agent = learned(trials=2, refinements=0)
    agent.perception.recordings = agent.perception.recordings[1:]
    dynamics = agent.model.dynamics(agent.transitions)
    rows = agent.perception.refined(agent.transitions, dynamics)
    assert len(rows) == len(agent.transitions)
    same = (rows.states == agent.transitions.states).all(axis=1)
    assert same[:STEPS].all()
    assert not same[STEPS:].any()


def test_a_negative_count_is_refused() -> None:
    with pytest.raises(InputError, match="refinements must be >= 0, got -1"):
        EstimatorConfig(refinements=-1)
