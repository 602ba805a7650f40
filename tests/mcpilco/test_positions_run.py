"""Laws of a run that measures positions only: what its folder holds is enough for every command."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from mcpilco.agent import MCPILCO, agent_of
from mcpilco.cli import main
from mcpilco.config import PRESETS
from mcpilco.files import read_groups, write_groups
from mcpilco.logbook import RunFolder, read_history
from mcpilco.show.film import Reel, write_run_film
from mcpilco.typing import EnvError, RunFolderError
from tests.mcpilco.agent.test_policy_file import PAGE, predict_of_the_page
from tests.mcpilco.sensing.test_perception import POSITIONS, STEPS, hasty
from tests.mcpilco.show.test_film import entities
from tests.mcpilco.survival import content

ARGUMENTS = ["--env", POSITIONS, "--horizon", str(STEPS), "--seed", "4", "--quiet"]


@pytest.fixture(scope="module", autouse=True)
def small_agent() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(PRESETS, "default", dataclasses.replace(PRESETS["default"], config=hasty()))
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("positions") / "whole"
    assert main(["train", *ARGUMENTS, "--trials", "2", "--out", str(path)]) == 0
    return path


class Failing(gym.Wrapper):
    """Raises at one step of one episode, counted from 0; `None` never does."""

    def __init__(self, episode: int, step: int) -> None:
        super().__init__(gym.make(POSITIONS, max_episode_steps=STEPS))
        self.when, self.now = (episode, step), (-1, 0)

    def reset(self, **kwargs):
        self.now = (self.now[0] + 1, 0)
        return self.env.reset(**kwargs)

    def step(self, action):
        self.now = (self.now[0], self.now[1] + 1)
        if self.now == self.when:
            raise OSError("cable")
        return self.env.step(action)


@pytest.mark.slow
def test_a_resumed_run_equals_the_uninterrupted_one(whole: Path, tmp_path: Path) -> None:
    path = tmp_path / "run"
    assert main(["train", *ARGUMENTS, "--trials", "1", "--out", str(path)]) == 0
    assert content(path) != content(whole)
    assert main(["train", "--resume", str(path), "--trials", "2", "--quiet"]) == 0
    assert content(path) == content(whole)


def test_each_trial_is_judged_behind_its_own_estimator(whole: Path) -> None:
    run = RunFolder.open(whole)
    first, last = agent_of(run, 1), agent_of(run, 2)
    assert not np.array_equal(first.perception.estimator.gains, last.perception.estimator.gains)
    for agent, trial in ((first, 1), (last, 2)):
        rollout = run.read_arrays(trial, "rollout")
        act = agent.controller()
        for seen, applied in zip(rollout["observations"], rollout["inputs"], strict=False):
            np.testing.assert_array_equal(act(seen), applied.astype(np.float32))


@pytest.mark.slow
def test_its_history_film_and_report_show_states_and_what_was_seen_of_them(
    whole: Path, tmp_path: Path
) -> None:
    history = read_history(RunFolder.open(whole))
    assert not history.problems
    for trial in history.trials:
        assert trial.rollout.observations.shape == (STEPS + 1, 2)
        assert trial.rollout.smoothed.shape == trial.rollout.states.shape == (STEPS + 1, 4)
    write_run_film(tmp_path / "film.rrd", [Reel(history)])
    shown = entities(tmp_path / "film.rrd")
    assert "states/pole_velocity/system" in shown
    assert not any(name.endswith(("observed", "estimated", "smoothed")) for name in shown)
    seen = entities(whole / "rollouts" / "01.rrd")
    assert {"states/pole_angle/observed", "states/pole_velocity/estimated"} <= seen
    assert "states/pole_velocity/observed" not in seen
    page = tmp_path / "report.html"
    assert main(["report", str(whole), "--out", str(page)]) == 0
    assert "This cannot be shown" not in page.read_text()


def test_a_history_without_the_smoothed_states_is_damaged(whole: Path, tmp_path: Path) -> None:
    run = RunFolder.open(shutil.copytree(whole, tmp_path / "run"))
    arrays = run.read_arrays(1, "rollout")
    run.write_arrays(1, "rollout", {k: v for k, v in arrays.items() if k != "smoothed"})
    (problem,) = read_history(run).problems
    assert "smoothed" in problem


def test_evaluate_judges_it(whole: Path, capsys) -> None:
    assert main(["evaluate", str(whole), "--episodes", "2", "--trial", "1", "--json"]) == 0
    assert np.isfinite(json.loads(capsys.readouterr().out)["return"]["mean"])


def test_its_policy_acts_with_numpy_alone(whole: Path, tmp_path: Path, monkeypatch) -> None:
    assert main(["export", str(whole), str(tmp_path / "policy.npz")]) == 0
    predict = predict_of_the_page(tmp_path, monkeypatch)
    block = re.search(r"```python\n(def estimate.*?)^```", PAGE.read_text(), re.M | re.S)[1]
    namespace = {}
    exec(block, namespace)
    policy = dict(np.load("policy.npz"))
    act, x = agent_of(RunFolder.open(whole), 2).controller(), policy["estimator.start"]
    for t, seen in enumerate(np.random.default_rng(0).normal(size=(8, 2))):
        known, x = namespace["estimate"](policy, t, x, seen)
        np.testing.assert_allclose(predict(known), act(seen), rtol=1e-6, atol=1e-6)


def test_records_of_it_have_the_measured_columns(whole: Path, tmp_path: Path) -> None:
    arguments = ["--policy", str(whole), "--seconds", "3", "--rollouts", "1", "--quiet"]
    assert main(["record", *arguments, "--out", str(tmp_path)]) == 0
    (path,) = tmp_path.iterdir()
    header, first, *_ = path.read_text().splitlines()
    values = dict(zip(header.split(","), first.split(","), strict=True))
    assert {name for name, value in values.items() if value} == {
        "time",
        "cart_position",
        "pole_angle",
        "force",
    }


def test_an_env_that_breaks_off_after_a_step_leaves_what_it_told() -> None:
    agent = MCPILCO("SumOfGaussians", Failing(episode=1, step=2), config=hasty(), seed=4)
    agent.learn(3 * STEPS)
    assert [bool(result.failure) for result in agent.results] == [True, False]
    assert agent.num_timesteps == 2 * STEPS + 1
    assert agent.results[0].rollout.smoothed.shape == (2, 4)


@pytest.mark.slow
def test_an_env_that_fails_at_once_leaves_policy_and_estimator_as_they_were() -> None:
    agent = MCPILCO("SumOfGaussians", Failing(episode=2, step=1), config=hasty(), seed=4)
    with pytest.raises(EnvError, match="OSError at step 1"):
        agent.learn(3 * STEPS)
    undisturbed = MCPILCO("SumOfGaussians", POSITIONS, config=hasty(), seed=4).learn(2 * STEPS)
    acts = agent.controller(), undisturbed.controller()
    for seen in np.random.default_rng(0).normal(size=(4, 2)):
        np.testing.assert_array_equal(*(act(seen) for act in acts))
    agent.learn(STEPS)
    undisturbed.learn(STEPS)
    assert agent.results[-1].real_cost == undisturbed.results[-1].real_cost


def test_an_agent_of_all_states_written_before_they_could_be_measured_in_part_is_read(
    tmp_path: Path,
) -> None:
    env, config = "mcpilco/CartPoleSwingUp-v0", hasty()
    agent = MCPILCO("SumOfGaussians", env, config=config, seed=4).learn(2 * STEPS)
    about, arrays = read_groups(agent.save(tmp_path / "agent.npz"))
    del about["task"]["measured"], about["task"]["measurement_std"], about["config"]["estimator"]
    write_groups(tmp_path / "older.npz", about, arrays)
    seen = np.ones(4)
    older = MCPILCO.load(tmp_path / "older.npz", env)
    np.testing.assert_array_equal(older.predict(seen)[0], agent.predict(seen)[0])
    with pytest.raises((EnvError, RunFolderError)):
        MCPILCO.load(tmp_path / "older.npz", POSITIONS)
