"""MC-PILCO as a source of data for SAC and TQC."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
import torch

import baselines.sb3.from_model as module
import envs  # noqa: F401  registers its ids
from baselines.sb3 import SACAgent, WarmStart, make_learner, warm_start
from baselines.sb3.from_model import Imagination, Perturbed
from mcpilco import MCPILCO
from mcpilco.cli import main
from mcpilco.config import PRESETS
from mcpilco.files import read_arrays, write_arrays
from mcpilco.typing import InputError
from tests.baselines.sb3.small import TINY
from tests.baselines.sb3.test_commands import files, tiny_presets  # noqa: F401  a fixture
from tests.mcpilco.point import STEPS, TASK, PointEnv
from tests.mcpilco.point import TINY as PARTICLES

FEW = WarmStart(particles=4, first_steps=2, rounds=1, own_particles=2, round_steps=1)
SAC = dataclasses.replace(TINY["sac"], horizon=STEPS)


@pytest.fixture(scope="module")
def source() -> MCPILCO:
    agent = MCPILCO("SumOfGaussians", PointEnv(), config=PARTICLES, seed=0)
    return agent.learn(agent.timesteps_of(2))


def new(algo: str = "sac", **changes) -> SACAgent:
    config = dataclasses.replace(TINY[algo], horizon=STEPS, **changes)
    return make_learner(algo, PointEnv(), config=config)


def weights(agent) -> list[np.ndarray]:
    return [value.numpy() for value in agent.learner.policy.state_dict().values()]


@pytest.mark.parametrize("algo", ["sac", "tqc"])
def test_the_buffer_holds_what_the_particles_did(source, algo):
    agent = new(algo)
    warm_start(agent, source, FEW)
    assert agent.learner.replay_buffer.pos == FEW.rollouts * STEPS
    assert agent.borrowed_timesteps == len(source.transitions)
    assert agent.num_timesteps == 0


def test_rewards_are_what_the_task_gives_for_where_particles_come(source):
    rows = Imagination(source).rollouts(source.policy, 5, torch.Generator().manual_seed(0))
    costs = TASK.cost(torch.from_numpy(rows.next_states), torch.from_numpy(rows.inputs))
    np.testing.assert_allclose(rows.rewards, 1.0 - costs.numpy())
    assert len(rows) == 5 * STEPS


def test_imagined_steps_are_those_that_the_env_would_make(source):
    """Of a unit mass v' = v + dt u; the error is small beside the change."""
    rows = Imagination(source).rollouts(source.policy, 20, torch.Generator().manual_seed(0))
    velocities = rows.states[:, 1] + TASK.dt * rows.inputs[:, 0]
    error = np.abs(rows.next_states[:, 1] - velocities)
    assert np.median(error) < 0.2 * np.abs(velocities - rows.states[:, 1]).mean()


def test_who_never_follows_the_policy_acts_by_chance_alone(source):
    count, generator = 2000, torch.Generator().manual_seed(0)
    begin, std = torch.full((count,), 9.0), torch.zeros(count)
    with torch.no_grad():
        inputs = Perturbed(source, begin, std, generator)(torch.zeros(count, 2).double(), step=8)
    low, high = float(source.low[0]), float(source.high[0])
    assert float(inputs.min()) >= low
    assert float(inputs.max()) <= high
    # of a uniform distribution: standard error of the mean, and of the variance
    spread = (high - low) / np.sqrt(12)
    assert abs(float(inputs.mean()) - (low + high) / 2) < 4 * spread / np.sqrt(count)
    assert float(inputs.std()) == pytest.approx(spread, rel=0.1)


def test_who_follows_the_policy_without_noise_acts_as_it_does(source):
    states = torch.linspace(-1, 1, 6, dtype=torch.float64).reshape(3, 2)
    still = Perturbed(source, torch.zeros(3), torch.zeros(3), torch.Generator())
    torch.testing.assert_close(still(states), source.policy(states))


def test_equal_seeds_begin_equally(source):
    one, again = new(), new()
    warm_start(one, source, FEW)
    warm_start(again, source, FEW)
    assert all(map(np.array_equal, weights(one), weights(again)))


def test_experience_counts_what_the_model_was_learned_from(source):
    agent = new()
    warm_start(agent, source, FEW)
    agent.learn(12)
    steps = 12 + source.num_timesteps
    assert agent.results[0].experience_s == pytest.approx(steps * TASK.dt)


def test_a_saved_warm_start_goes_on_as_it_would_have(source, tmp_path):
    agent = new()
    warm_start(agent, source, FEW)
    loaded = SACAgent.load(agent.save(tmp_path / "warm.npz"), PointEnv())
    assert all(map(np.array_equal, weights(agent.learn(12)), weights(loaded.learn(12))))
    assert loaded.borrowed_timesteps == source.num_timesteps


@pytest.mark.slow
def test_a_policy_is_learned_in_the_model_alone(source):
    """The cost is least at 1 m: an idle policy would pay 6 (1 - 1/e)."""
    agent = new(buffer_size=10_000, gamma=0.9, learning_rate=3e-3, batch_size=64, ent_coef=0.01)
    numbers = WarmStart(particles=60, first_steps=300, rounds=4, own_particles=30, round_steps=100)
    warm_start(agent, source, numbers)
    record, _ = agent._run_episode(agent.inputs_in, 1, agent.horizon)
    assert (1.0 - record.rewards).sum() < 0.8 * STEPS * (1 - np.exp(-1))


def refusals(source: MCPILCO):
    untaught = MCPILCO("SumOfGaussians", PointEnv(), config=PARTICLES)
    other = make_learner("sac", "mcpilco/Pendulum-v0", config=SAC)
    ppo = make_learner(
        "ppo", PointEnv(), config=dataclasses.replace(TINY["ppo"], n_envs=1, horizon=STEPS)
    )
    return {
        "has none": (ppo, source),
        "new agent": (new().learn(12), source),
        "has done a trial": (new(), untaught),
        "same system": (other, source),
        "holds 20 transitions": (new(buffer_size=20), source),
    }


@pytest.mark.parametrize(
    "sentence",
    ["has none", "new agent", "has done a trial", "same system", "holds 20 transitions"],
)
def test_what_cannot_be_is_refused(source, sentence):
    agent, teacher = refusals(source)[sentence]
    with pytest.raises(InputError, match=sentence):
        warm_start(agent, teacher, FEW)


@pytest.mark.parametrize(
    ("numbers", "sentence"),
    [({"random": 0.7, "interrupted": 0.4}, "not exceed 1"), ({"particles": 0}, "at least 1")],
)
def test_wrong_numbers_are_refused(numbers, sentence):
    with pytest.raises(InputError, match=sentence):
        WarmStart(**numbers)


# --- on the command line --------------------------------------------------------------------------


@pytest.fixture
def run(tmp_path, monkeypatch, tiny_presets) -> Path:  # noqa: F811
    preset = dataclasses.replace(PRESETS["default"], config=PARTICLES)
    monkeypatch.setitem(PRESETS, "default", preset)
    monkeypatch.setattr(module, "DEFAULT", FEW)
    path = tmp_path / "mc"
    assert main(["train", "--trials", "1", "--quiet", "--out", str(path)]) == 0
    return path


def warm(source: Path, out: Path, *more: str) -> int:
    start = ["train", "--algo", "sac", "--warm-start", str(source), "--out", str(out), "--quiet"]
    return main([*start, *more])


def test_a_warm_started_run_counts_all_experience_and_names_its_source(run, tmp_path):
    assert warm(run, tmp_path / "sac", "--trials", "1") == 0
    row = (tmp_path / "sac" / "metrics.csv").read_text().splitlines()[1]
    assert float(row.split(",")[1]) == pytest.approx(0.1 * (12 + 2 * STEPS))
    config = json.loads((tmp_path / "sac" / "config.json").read_text())
    assert config["warm_start"] == str(run)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("moment", ["_learn", "_practise"])
def test_a_run_killed_while_it_warms_or_learns_goes_on(run, tmp_path, monkeypatch, moment):
    assert warm(run, tmp_path / "whole", "--trials", "1") == 0
    place = {"_learn": module, "_practise": SACAgent}[moment]
    with monkeypatch.context() as patch:
        patch.setattr(place, moment, lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            warm(run, tmp_path / "killed", "--trials", "1")
    assert main(["train", "--resume", str(tmp_path / "killed"), "--quiet"]) == 0
    assert files(tmp_path / "killed") == files(tmp_path / "whole")


def test_a_source_that_cannot_teach_is_refused_and_nothing_is_left(run, tmp_path, capsys):
    assert warm(run, tmp_path / "sac", "--trials", "1") == 0
    assert warm(tmp_path / "sac", tmp_path / "other") == 2
    assert "takes a run of the algorithm mcpilco" in capsys.readouterr().err
    assert warm(run, tmp_path / "other", "--algo", "ppo") == 2
    assert "the algorithm ppo has none" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_rewards_of_another_task_are_refused(run, tmp_path, capsys):
    path = run / "trials" / "01" / "rollout.npz"
    arrays = read_arrays(path)
    write_arrays(path, arrays | {"rewards": arrays["rewards"] - 3.0})
    assert warm(run, tmp_path / "sac") == 2
    assert "are not 1 - cost" in capsys.readouterr().err
