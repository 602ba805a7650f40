"""The agent PILCO: it learns, remembers, refuses, and is an algorithm of the command line."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

import envs  # noqa: F401  registers the cart-pole
from baselines.moments.costs import TipDistanceCost
from baselines.pilco import PILCO, PRESETS, PilcoConfig
from baselines.pilco import agent as pilco_agent
from mcpilco import MCPILCO
from mcpilco.cli import main
from mcpilco.config import Preset
from mcpilco.policies import SaturatingCost
from mcpilco.typing import InputError, RunFolderError
from tests.baselines.pilco.models import TINY
from tests.mcpilco.point import STEPS, TASK, PointEnv

pytestmark = pytest.mark.xdist_group(
    "compiled moments"
)  # one process compiles what all of them need

SMALL = dataclasses.replace(TINY, horizon=STEPS)
CART_POLE = "mcpilco/CartPoleSwingUp-v0"


def learned(trials: int, seed: int = 0, config: PilcoConfig = SMALL) -> PILCO:
    agent = PILCO("GPMean", PointEnv(), config=config, seed=seed)
    return agent.learn(agent.timesteps_of(trials))


def weights(agent: PILCO) -> list[np.ndarray]:
    return [value.numpy() for value in agent.policy.state_dict().values()]


def test_equal_seeds_learn_equally_and_others_do_not():
    first, again, other = learned(2), learned(2), learned(2, seed=1)
    assert all(map(np.array_equal, weights(first), weights(again)))
    assert not all(map(np.array_equal, weights(first), weights(other)))


def test_restarts_are_made_by_trial():
    config = dataclasses.replace(SMALL, restarts=(0, 2), failing=1e-12)
    assert [result.starts for result in learned(3, config=config).results] == [1, 3, 3]


@pytest.mark.parametrize("wrong", [{"restarts": ()}, {"restarts": (1, -1)}, {"failing": 0.0}])
def test_restarts_that_are_none_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        dataclasses.replace(SMALL, **wrong)


def test_it_learns_to_move_a_point():
    """The cost is least at 1 m: an idle policy would pay 6 (1 - 1/e)."""
    config = PilcoConfig(centres=5, line_searches=15, horizon=STEPS)
    result = learned(2, config=config).results[-1]
    assert result.real_cost < 0.8 * STEPS * (1 - np.exp(-1))
    assert result.predicted_cost == pytest.approx(result.real_cost, abs=0.4)


def test_a_loaded_agent_goes_on_as_the_saved_one_would(tmp_path):
    whole, half = learned(2), learned(1)
    loaded = PILCO.load(half.save(tmp_path / "half.npz"), PointEnv())
    loaded.learn(loaded.timesteps_of(1))
    assert all(map(np.array_equal, weights(whole), weights(loaded)))
    observation = np.array([0.1, 0.2])
    assert whole.predict(observation)[0] == loaded.predict(observation)[0]


def test_an_agent_is_loaded_without_an_env_to_predict(tmp_path):
    agent = learned(1)
    alone = PILCO.load(agent.save(tmp_path / "agent.npz"))
    assert alone.predict(np.zeros(2))[0] == agent.predict(np.zeros(2))[0]


def test_a_file_is_loaded_by_the_class_of_its_algorithm_only(tmp_path):
    path = learned(1).save(tmp_path / "pilco.npz")
    with pytest.raises(RunFolderError, match="algorithm 'pilco', expected one of 'mcpilco'"):
        MCPILCO.load(path, PointEnv())


def test_a_search_without_an_answer_is_a_trial_that_tells_why(monkeypatch):
    def fail(*_):
        raise torch.linalg.LinAlgError("no covariance")

    monkeypatch.setattr(pilco_agent, "pilco_search", fail)
    result = learned(1).results[-1]
    assert "No policy could be learned: no covariance" in result.failure


@pytest.mark.parametrize(
    ("task", "config", "sentence"),
    [
        (dataclasses.replace(TASK, measured=(0,)), SMALL, "all states are measured"),
        (dataclasses.replace(TASK, cost=None), SMALL, "needs a task with a cost"),
        (dataclasses.replace(TASK, cost=lambda x, u: x[..., 0]), SMALL, "expected cost is known"),
        (TASK, dataclasses.replace(SMALL, cost="tip"), "`tip` is of a cart-pole"),
    ],
)
def test_what_it_cannot_learn_is_refused_with_a_sentence(task, config, sentence):
    env = PointEnv()
    if task.measured is not None:
        env.observation_space = type(env.observation_space)(-np.inf, np.inf, (1,), np.float64)
    with pytest.raises(InputError, match=sentence):
        PILCO("GPMean", env, config=config, task=task)


@pytest.mark.parametrize("wrong", [{"centres": 0}, {"longest": 1.0}, {"cost": "other"}])
def test_numbers_that_make_no_sense_are_refused(wrong):
    with pytest.raises(InputError):
        PilcoConfig(**wrong)


def test_presets_differ_in_the_cost():
    costs = [type(PILCO("GPMean", CART_POLE, preset=name).task.cost) for name in ("default", "tip")]
    assert costs == [SaturatingCost, TipDistanceCost]


# The command line ---------------------------------------------------------------------------------


@pytest.fixture
def hasty(monkeypatch):
    for name, preset in PRESETS.items():
        config = dataclasses.replace(TINY, cost=preset.config.cost)
        monkeypatch.setitem(PRESETS, name, Preset(preset.summary, config))


def train(folder: Path, *more: str) -> int:
    argv = ["--algo", "pilco", "--horizon", "5", "--quiet", "--out", str(folder)]
    return main(["train", *argv, *more])


@pytest.mark.usefixtures("hasty", "unchecked_shapes")
def test_a_run_is_trained_evaluated_reported_and_resumed(tmp_path, capsys):
    whole, half = tmp_path / "whole", tmp_path / "half"
    assert train(whole, "--trials", "2") == 0
    assert train(half, "--trials", "1") == 0
    assert main(["train", "--resume", str(half), "--trials", "2", "--quiet"]) == 0
    policies = [np.load(run / "trials/02/policy.npz")["targets"] for run in (whole, half)]
    assert np.array_equal(*policies)
    config = json.loads((whole / "config.json").read_text())
    assert (config["algo"], config["preset"]) == ("pilco", "default")
    capsys.readouterr()
    assert main(["evaluate", str(whole), "--episodes", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["episodes"] == 2
    assert main(["report", str(whole)]) == 0
    page = (whole / "report.html").read_text()
    assert "pilco default, seed 0" in page
    assert "cannot be" not in page
    assert main(["export", str(whole), str(tmp_path / "policy.npz")]) == 2
    assert "SumOfGaussians" in capsys.readouterr().err


@pytest.mark.usefixtures("hasty")
def test_a_preset_of_another_algorithm_is_refused(tmp_path, capsys):
    assert train(tmp_path / "run", "--preset", "thesis") == 2
    assert "--preset of the algorithm pilco must be one of" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.usefixtures("hasty")
def test_a_run_of_an_unknown_algorithm_is_refused(tmp_path, capsys):
    assert train(tmp_path / "run", "--trials", "1") == 0
    path = tmp_path / "run/config.json"
    path.write_text(path.read_text().replace('"algo": "pilco"', '"algo": "os:system"'))
    assert main(["evaluate", str(tmp_path / "run")]) == 2
    assert "must be one of" in capsys.readouterr().err
