from __future__ import annotations

import dataclasses
import json
import sys

import gymnasium as gym
import pytest

from mcpilco.config import PolicyConfig, SearchConfig


@pytest.fixture
def hasty(run, monkeypatch):
    """A pendulum that learns nothing in no time."""
    search = SearchConfig(particles=8, steps=(2,), restarts=(0,), evaluation_particles=8)
    case = run.CASES["pendulum"]
    config = dataclasses.replace(case.config, policy=PolicyConfig(bases=10), search=search)
    case = dataclasses.replace(case, config=config, trials=1, fresh=1)
    monkeypatch.setitem(run.CASES, "pendulum", case)
    return case


@pytest.mark.slow  # trains, if quickly
def test_run_trains_a_case_and_writes_its_page_from_all_that_is_there(
    run, hasty, tmp_path, monkeypatch
):
    arguments = ["--only", "pendulum", "--seeds", "0:1", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["run.py", *arguments])
    assert run.main() == 0
    text = (tmp_path / "README.md").read_text()
    assert "| pendulum | -200 | 0 of 1 | – | – | -" in text
    assert "| seed 0 | -" in text
    about = json.loads((tmp_path / "results" / "pendulum" / "sweep.json").read_text())
    assert about["fresh_horizon"] == hasty.limit
    assert about["config"]["horizon"] == hasty.config.horizon


def test_solved_is_the_first_policy_that_reaches_the_threshold(run):
    case = run.CASES["inverted_pendulum"]
    trials = [
        {"fresh_return": value, "experience_s": 0.04 * steps}
        for value, steps in ((949.0, 100), (951.0, 160), (100.0, 220))
    ]
    assert run.solved_at(case, trials) == 160
    assert run.solved_at(case, trials[:1]) is None


def test_every_case_learns_from_fewer_than_30_episodes_and_is_judged_on_whole_ones(run):
    for case in run.CASES.values():
        spec = gym.spec(case.env)
        assert case.limit == spec.max_episode_steps
        assert spec.reward_threshold in (None, case.threshold)
        horizon = case.config.horizon
        steps = (case.config.exploration or horizon) + case.trials * horizon
        assert steps < 30 * case.limit
        assert case.task is None or case.task.exists()
