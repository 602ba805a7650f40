from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from mcpilco.files import write_groups
from mcpilco.logbook.history import read_history, read_search, read_task
from mcpilco.logbook.run_folder import RunFolder
from mcpilco.show.recorder import Recorder
from mcpilco.typing import RunFolderError
from tests.mcpilco.fakes import FakeAgent
from tests.mcpilco.logbook.test_run_folder import CONFIG

gym = pytest.importorskip("gymnasium")
STEPS = 5


@pytest.fixture(scope="module")
def agent():
    import envs  # noqa: F401

    return FakeAgent("SumOfGaussians", gym.make(CONFIG["env"], max_episode_steps=STEPS))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory, agent):
    """The folder of what it did."""
    run = RunFolder.create(tmp_path_factory.mktemp("history") / "run", CONFIG)
    agent.learn(3 * STEPS, Recorder(run))
    return run.path


@pytest.fixture
def run(recorded, tmp_path):
    """A copy of it, to be damaged."""
    return RunFolder.open(Path(shutil.copytree(recorded, tmp_path / "run")))


def test_what_was_recorded_is_read_back(run, agent):
    history = read_history(run)
    assert [trial.number for trial in history.trials] == [0, 1, 2]
    assert history.problems == ()
    for trial, result in zip(history.learned, agent.results, strict=True):
        for name in ("observations", "inputs", "rewards", "states"):
            expected = getattr(result.rollout, name)
            np.testing.assert_array_equal(getattr(trial.rollout, name), expected)
        assert trial.rollout.outcome == dict(result.rollout.outcome)
        np.testing.assert_array_equal(trial.prediction.states, result.prediction.states)
        told = ("experience_s", "predicted_cost", "predicted_cost_std", "real_cost", "success")
        for name in told:
            assert getattr(trial, name) == getattr(result, name)


def test_the_spread_of_a_folder_that_does_not_tell_it_is_that_of_the_kept_particles(run, agent):
    (run.path / "trials" / "01" / "result.json").unlink()
    costs = agent.results[0].prediction.costs
    assert read_history(run).learned[0].predicted_cost_std == costs.sum(0).std(ddof=1)


def test_costs_of_the_rollout_are_those_of_the_task(run, agent):
    for trial in read_history(run).trials:
        np.testing.assert_allclose(trial.costs, 1 - trial.rollout.rewards)


def test_task_is_that_of_the_agent_but_for_the_cost(run, agent):
    assert read_task(run).to_json() == agent.task.to_json()


def test_older_folder_tells_the_task_by_its_agent(run, agent):
    (run.path / "task.json").unlink()
    write_groups(run.agent_path, {"task": agent.task.to_json()}, {"policy": {"a": np.ones(1)}})
    assert read_task(run).to_json() == agent.task.to_json()


@pytest.mark.parametrize("text", ["{}", "[]", '{"state_names": 3}', "{", '{"strange": 1}'])
def test_damaged_task_is_refused(run, text):
    (run.path / "task.json").write_text(text)
    with pytest.raises(RunFolderError, match=r"task.json is damaged"):
        read_task(run)


def test_trial_without_its_row_is_not_finished(run):
    path = run.path / "metrics.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    assert [trial.number for trial in read_history(run).trials] == [0, 1]


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("rollout", {"inputs": np.ones((STEPS, 3))}),
        ("rollout", {"observations": np.ones((STEPS, 4))}),
        ("rollout", {"dt": np.array(0.0)}),
        ("rollout", {"dt": np.array("a")}),
        ("rollout", {"inputs": np.ones((0, 1))}),
        ("particles", {"costs": np.ones((STEPS, 0))}),
        ("particles", {"states": np.ones((STEPS + 1, 2, 4))}),
        ("particles", {"costs": np.ones(STEPS)}),
    ],
)
def test_arrays_that_do_not_fit_are_left_out_and_named(run, name, change):
    run.write_arrays(1, name, {**run.read_arrays(1, name), **change})
    history = read_history(run)
    assert [trial.number for trial in history.trials] == [0, 2]
    (problem,) = history.problems
    assert f"01/{name}.npz is damaged, or of another task" in problem


def test_array_that_is_missing_is_named(run):
    arrays = run.read_arrays(2, "particles")
    arrays.pop("inputs")
    run.write_arrays(2, "particles", arrays)
    assert "particles.npz is damaged" in read_history(run).problems[0]


def test_data_before_a_trial_are_those_of_all_earlier_ones(run):
    history = read_history(run)
    data = history.transitions_before(history.learned[1])
    seen = [history.trials[number].rollout.observations for number in (0, 1)]
    np.testing.assert_array_equal(data.states, np.concatenate([rows[:-1] for rows in seen]))
    np.testing.assert_array_equal(data.next_states, np.concatenate([rows[1:] for rows in seen]))


def test_search_is_read_up_to_a_line_that_was_cut_off(run):
    lines = [
        {"time/trial": 1, "model/samples": 5.0},
        {"time/trial": 1, "time/step": 1, "policy/cost": 4.0},
        {"time/trial": 1, "time/step": 2, "policy/cost": None},
        {"time/trial": 2, "time/step": 1, "policy/cost": 3.0},
    ]
    text = "".join(json.dumps(line) + "\n" for line in lines)
    run.policy_steps_path.write_text(text + '{"time/trial": 2, "time/st')
    costs = read_search(run)
    np.testing.assert_array_equal(costs[1], [4.0, np.nan])
    assert costs[2] == [3.0]
