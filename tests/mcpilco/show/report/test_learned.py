from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from mcpilco.agent import MCPILCO, Model
from mcpilco.data import Prediction, Transitions
from mcpilco.logbook import RunFolder
from mcpilco.show.report.learned import (
    LEVELS,
    OneStep,
    one_step,
    policy_maps,
    read_policy,
    rollout_coverage,
    rollout_errors,
)
from mcpilco.typing import RunFolderError


def steps(errors, std) -> OneStep:
    return OneStep(("v",), ("m/s",), errors, np.full_like(errors, std))


def prediction(states) -> Prediction:
    rows, particles, _ = states.shape
    return Prediction(states, np.zeros((rows - 1, particles, 1)), np.zeros((rows - 1, particles)))


@pytest.fixture
def normal() -> np.ndarray:
    return np.random.default_rng(0).standard_normal((20_000, 1))


def test_true_spread_covers_the_truth_at_every_level(normal) -> None:
    np.testing.assert_allclose(steps(2 * normal, 2.0).coverage(LEVELS)[:, 0], LEVELS, atol=0.012)


def test_half_the_spread_covers_too_little_and_twice_too_much(normal) -> None:
    half, twice = (steps(normal, std).coverage(np.array([0.95]))[0, 0] for std in (0.5, 2.0))
    assert half == pytest.approx(0.673, abs=0.01)  # 2 Phi(1.96 / 2) - 1
    assert twice == pytest.approx(0.99991, abs=1e-3)  # 2 Phi(1.96 * 2) - 1


def test_trials_are_joined_row_by_row(normal) -> None:
    joined = steps(normal[:3], 1.0) + steps(normal[3:5], 2.0)
    np.testing.assert_array_equal(joined.errors, normal[:5])
    assert joined.std[:, 0].tolist() == [1.0, 1.0, 1.0, 2.0, 2.0]


def test_particles_of_one_law_with_the_truth_cover_it_at_every_level() -> None:
    rng = np.random.default_rng(1)
    truth, particles = rng.normal(size=(4001, 1)), rng.normal(size=(4001, 200, 1))
    covered = rollout_coverage(truth, prediction(particles), LEVELS)[:, 0]
    np.testing.assert_allclose(covered, LEVELS, atol=0.025)


def test_truth_outside_all_particles_is_never_covered() -> None:
    states = np.random.default_rng(2).normal(size=(11, 50, 2))
    truth = np.stack([np.full(11, 9.0), states[:, :, 1].mean(axis=1)], axis=-1)
    covered = rollout_coverage(truth, prediction(states), LEVELS)
    assert (covered[:, 0] == 0).all()
    assert (covered[LEVELS > 0.5, 1] > 0).all()


def test_error_of_particles_around_a_shifted_path_is_shift_and_spread() -> None:
    rng = np.random.default_rng(3)
    truth = np.zeros((6, 1))
    particles = 3.0 + 4.0 * rng.standard_normal((9, 20_000, 1))
    errors = rollout_errors(truth, prediction(particles))
    assert errors.shape == (6, 1)  # as far as both go
    np.testing.assert_allclose(errors, 5.0, rtol=0.02)


def test_model_had_not_seen_the_trial_that_it_is_judged_by(history) -> None:
    """The posterior that a trial's steps are compared with is that of the data before it."""
    trial = history.learned[1]
    found = one_step(history, trial)
    model = Model(steps_config(history), history.task)
    model.load_arrays(history.run.read_arrays(2, "gp"))
    before = [Transitions(**history.run.read_arrays(n, "transitions")) for n in (0, 1)]
    posterior = model.gp.condition(*model.rows(model.known(before[0] + before[1])))
    X, Y = model.rows(Transitions(**history.run.read_arrays(2, "transitions")))
    mean, variance = posterior.mean_and_variance(X)
    torch.testing.assert_close(torch.from_numpy(found.errors), (Y - mean).detach())
    expected = (variance + posterior.noise_std.square()).sqrt()
    torch.testing.assert_close(torch.from_numpy(found.std), expected.detach())


def steps_config(history):
    from mcpilco.show.report.learned import read_agent

    return read_agent(history)[1].model


def test_model_of_another_task_is_refused(history) -> None:
    history.run.write_arrays(1, "gp", {"noise": np.ones(2)})
    with pytest.raises(RunFolderError, match=r"gp.npz is damaged, or of another task"):
        one_step(history, history.learned[0])


def test_data_that_are_not_all_there_are_no_calibration(history) -> None:
    rows = history.run.read_arrays(0, "transitions")
    history.run.write_arrays(0, "transitions", {name: a[:-3] for name, a in rows.items()})
    with pytest.raises(RunFolderError, match="was learned from 0.8 s of data, .* holds 0.5 s"):
        one_step(history, history.learned[0])


def test_agent_of_a_later_version_is_named(run, history) -> None:
    config = {**run.config, "config": {**run.config["config"], "strange": 1}}
    later = type(history)(
        RunFolder(run.path, config), history.task, history.trials, history.problems
    )
    with pytest.raises(RunFolderError, match=r"config.json does not hold the agent's numbers"):
        one_step(later, later.learned[0])


def test_policy_read_answers_as_the_saved_agent(history) -> None:
    import envs  # noqa: F401

    agent = MCPILCO.load(history.run.agent_path)
    trial = history.learned[-1]
    policy = read_policy(history, trial)
    import torch

    for state in trial.rollout.observations[:3]:
        action, _ = agent.predict(state)
        with torch.no_grad():
            np.testing.assert_allclose(policy(torch.from_numpy(state[None]))[0], action, rtol=1e-6)


def test_there_is_a_map_for_each_position_with_its_velocity(history) -> None:
    labels = [found.labels for found in policy_maps(history, history.learned[-1])]
    assert labels == [
        ("cart_position [m]", "cart_velocity [m/s]", "force [N]"),
        ("pole_angle [rad]", "pole_velocity [rad/s]", "force [N]"),
    ]


def test_map_holds_what_the_policy_answers_with_the_other_states_at_the_end(history) -> None:
    import torch

    trial = history.learned[-1]
    policy = read_policy(history, trial)
    found = policy_maps(history, trial)[1]
    state = trial.rollout.shown_states[-1].copy()
    state[2], state[3] = found.x[7], found.y[40]
    with torch.no_grad():
        expected = policy(torch.from_numpy(state[None])).item()
    assert found.values[40, 7] == pytest.approx(expected)
    assert (found.low, found.high) == (-10.0, 10.0)
    np.testing.assert_array_equal(found.path, trial.rollout.shown_states[:, 2:])
    for values, path in zip((found.x, found.y), found.path.T, strict=True):
        assert values[0] < path.min()
        assert path.max() < values[-1]


def test_without_velocities_a_map_spans_any_two_states(history) -> None:
    task = dataclasses.replace(history.task, velocities=())
    plain = dataclasses.replace(history, task=task)
    labels = [found.labels[:2] for found in policy_maps(plain, plain.learned[-1])]
    assert len(labels) == 6
    assert ("cart_position [m]", "pole_angle [rad]") in labels


@pytest.mark.parametrize("change", ["lost", "reshaped"])
def test_policy_that_does_not_fit_is_refused(history, change) -> None:
    arrays = history.run.read_arrays(2, "policy")
    arrays.pop("weights")
    if change == "reshaped":
        arrays["weights"] = np.ones((3, 3))
    history.run.write_arrays(2, "policy", arrays)
    with pytest.raises(RunFolderError, match=r"policy.npz is damaged, or of another task"):
        read_policy(history, history.learned[-1])
