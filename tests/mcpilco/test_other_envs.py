"""Laws of an agent in an env that was not made for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

from mcpilco.agent import MCPILCO
from mcpilco.cli import main
from mcpilco.config import PRESETS, Config
from mcpilco.logbook import RunFolder
from mcpilco.policies import RewardCost, TipCost, held
from mcpilco.typing import EnvError, InputError
from tests.mcpilco.point import TINY
from tests.mcpilco.survival import content
from tests.mcpilco.swinging import CIRCLE, TASK, Swinging

STEPS = 12
SHORT = replace(TINY, horizon=STEPS)
UPRIGHT = TipCost((0,), (1.0,), 1.0)
GIVEN = replace(TASK, cost=UPRIGHT)
CIRCULAR = replace(GIVEN, **CIRCLE)
TURNING = Path(__file__).parents[2] / "runs" / "other_envs" / "pendulum.toml"


def agent_in(env: gym.Env, task=GIVEN, config: Config = SHORT) -> MCPILCO:
    return MCPILCO("SumOfGaussians", env, config=config, seed=0, task=task)


def test_cosine_and_sine_teach_what_the_angle_itself_does() -> None:
    told = agent_in(Swinging(push=9.0)).learn(3 * STEPS)
    seen = agent_in(Swinging("circle", push=9.0), CIRCULAR).learn(3 * STEPS)
    np.testing.assert_allclose(seen.transitions.states, told.transitions.states, atol=1e-6)
    for mine, its in zip(seen.results, told.results, strict=True):
        assert mine.predicted_cost == pytest.approx(its.predicted_cost, rel=1e-5)
        assert mine.real_cost == pytest.approx(its.real_cost, rel=1e-5)


def test_predict_takes_the_observations_of_the_env() -> None:
    agent = agent_in(Swinging("circle"), CIRCULAR).learn(2 * STEPS)
    angle, velocity = 2.0, -1.0
    action, _ = agent.predict(np.array([np.cos(angle), np.sin(angle), velocity]))
    with torch.no_grad():
        policy = agent.policy(torch.tensor([angle, velocity], dtype=torch.float64)).numpy()
    np.testing.assert_allclose(action, policy, rtol=1e-6)
    assert agent.predict(np.zeros((4, 3)))[0].shape == (4, 1)
    with pytest.raises(InputError, match="observations of 3 numbers"):
        agent.predict(np.zeros(2))


def test_a_state_beyond_the_observation_is_answered_with_a_sentence() -> None:
    with pytest.raises(EnvError, match="finds a state in observation 2, .* has 2 numbers"):
        agent_in(Swinging(), CIRCULAR)


def test_random_inputs_go_on_in_further_episodes_until_there_are_enough() -> None:
    agent = agent_in(Swinging(ends=0.5), config=replace(SHORT, exploration=40))
    records = agent._explore()
    assert sum(map(len, records)) == agent.num_timesteps == 40
    assert any(len(record) < STEPS for record in records[:-1])
    assert max(map(len, records)) <= STEPS


def test_each_of_them_begins_at_a_start_of_its_own() -> None:
    agent = agent_in(Swinging(), config=replace(SHORT, exploration=3 * STEPS))
    starts = {record.observations[0].tobytes() for record in agent._explore()}
    assert len(starts) == 3


class Unplugged(Swinging):
    """Fails at the first step of its second episode."""

    episodes = 0

    def reset(self, **kwargs):
        self.episodes += 1
        return super().reset(**kwargs)

    def step(self, action):
        if (self.episodes, self.steps) == (2, 0):
            raise OSError("unplugged")
        return super().step(action)


def test_an_exploration_that_breaks_off_begins_anew_as_if_nothing_had_been() -> None:
    config = replace(SHORT, exploration=2 * STEPS)
    agent = agent_in(Unplugged(), replace(GIVEN, cost=None), config)
    with pytest.raises(EnvError, match="unplugged"):
        agent.learn(3 * STEPS)
    assert agent.num_timesteps == 0
    agent.learn(3 * STEPS)
    undisturbed = agent_in(Swinging(), replace(GIVEN, cost=None), config).learn(3 * STEPS)
    assert agent.results[0].real_cost == undisturbed.results[0].real_cost
    assert agent.results[0].predicted_cost == undisturbed.results[0].predicted_cost


@pytest.mark.parametrize("exploration", [None, 30])
def test_timesteps_of_trials_are_what_learn_spends(exploration: int | None) -> None:
    agent = agent_in(Swinging(), config=replace(SHORT, exploration=exploration))
    needed = agent.timesteps_of(2)
    with pytest.raises(InputError, match=f"got {needed - 2 * STEPS}"):
        agent.learn(needed - 2 * STEPS)
    agent.learn(needed)
    assert agent.num_timesteps == needed
    assert agent.timesteps_of(1) == STEPS


def test_a_trial_that_ended_early_has_its_last_cost_to_the_end() -> None:
    agent = agent_in(Swinging(ends=0.3)).learn(2 * STEPS)
    (result,) = agent.results
    record = result.rollout
    assert len(record) < STEPS
    with torch.no_grad():
        costs = UPRIGHT(torch.from_numpy(record.observations[1:])).numpy()
    assert result.real_cost == pytest.approx(held(costs, STEPS).sum())


# --- a cost learned from rewards ------------------------------------------------------------------


@pytest.fixture(scope="module")
def rewarded() -> MCPILCO:
    return agent_in(Swinging("circle"), replace(CIRCULAR, cost=None)).learn(3 * STEPS)


def test_without_a_cost_one_is_learned_from_all_rewards(rewarded: MCPILCO) -> None:
    cost = rewarded.task.cost
    assert isinstance(cost, RewardCost)
    assert len(cost.rewards) == 3 * STEPS
    last = rewarded.results[-1]
    assert last.real_cost == pytest.approx(cost.of_rewards(last.rollout.rewards).sum())
    assert 0.0 < rewarded.reference_cost < 1.0


def test_a_learned_cost_is_saved_with_the_agent(rewarded: MCPILCO, tmp_path: Path) -> None:
    path = rewarded.save(tmp_path / "agent")
    again = MCPILCO.load(path, Swinging("circle"))
    for agent in (again, rewarded):
        agent.task.cost.fit()  # as the next trial does
    states = torch.randn(20, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    inputs = torch.zeros(20, 1, dtype=torch.float64)
    torch.testing.assert_close(
        again.task.cost(states, inputs), rewarded.task.cost(states, inputs), rtol=0, atol=0
    )
    again.learn(STEPS)
    assert again.trials == 3
    assert len(again.task.cost.rewards) == 4 * STEPS


# --- saved agents ---------------------------------------------------------------------------------


def test_an_agent_predicts_the_same_without_its_env_and_its_task(tmp_path: Path) -> None:
    agent = agent_in(Swinging("circle"), CIRCULAR).learn(2 * STEPS)
    path = agent.save(tmp_path / "agent")
    observation = np.array([0.6, 0.8, 1.5])
    for env in (None, Swinging("circle")):
        again = MCPILCO.load(path, env)
        np.testing.assert_array_equal(again.predict(observation)[0], agent.predict(observation)[0])
    with pytest.raises(InputError, match="has no cost"):
        again.learn(STEPS)
    assert MCPILCO.load(path, Swinging("circle"), task=CIRCULAR).learn(STEPS).trials == 2


def test_a_guessed_cost_is_guessed_again(tmp_path: Path) -> None:
    agent = agent_in(gym.make("Pendulum-v1"), None).learn(2 * STEPS)
    path = agent.save(tmp_path / "agent")
    again = MCPILCO.load(path, gym.make("Pendulum-v1"))
    assert again.task == agent.task
    assert again.learn(STEPS).trials == 2


def test_another_cost_than_the_guessed_one_is_not_replaced_by_it(tmp_path: Path) -> None:
    env = gym.make("Pendulum-v1")
    task = replace(agent_in(env, None).task, cost=TipCost((0,), (1.0,), 0.5))
    path = agent_in(env, task).learn(2 * STEPS).save(tmp_path / "agent")
    with pytest.raises(InputError, match="has no cost"):
        MCPILCO.load(path, env).learn(STEPS)


# --- runs -----------------------------------------------------------------------------------------


class StoppedError(Exception):
    """At a moment of a test's choice."""


@pytest.fixture
def begin(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Begins a run with a task's file, whose cost is learned; its exploration is three rollouts."""
    monkeypatch.setitem(PRESETS, "default", replace(PRESETS["default"], config=SHORT))
    horizon = ["--horizon", str(STEPS), "--exploration", str(3 * STEPS)]

    def run(name: str, trials: int) -> Path:
        where = ["--out", str(tmp_path / name), "--task", str(TURNING), "--quiet"]
        argv = ["train", "--env", "Pendulum-v1", *horizon, *where, "--trials", str(trials)]
        assert main(argv) == 0
        return tmp_path / name

    return run


def resume(path: Path, *arguments: str) -> int:
    return main(["train", "--resume", str(path), "--trials", "2", "--quiet", *arguments])


@pytest.mark.slow
def test_a_resumed_run_with_a_learned_cost_equals_the_uninterrupted_one(begin, capsys) -> None:
    whole, path = begin("whole", 2), begin("run", 1)
    assert resume(path) == 2
    assert "pass that file again" in capsys.readouterr().err
    assert resume(path, "--task", str(TURNING)) == 0
    assert content(path) == content(whole)


@pytest.mark.slow
def test_a_run_stopped_between_its_random_rollouts_begins_anew(
    begin, tmp_path: Path, monkeypatch
) -> None:
    whole, path = begin("whole", 2), tmp_path / "run"
    write = RunFolder.write_arrays

    def stop(run: RunFolder, trial: int, name: str, arrays) -> None:
        if name == "rollout-2":
            raise StoppedError
        write(run, trial, name, arrays)

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "write_arrays", stop)
        with pytest.raises(StoppedError):
            begin("run", 2)
    assert (path / "trials" / "00" / "rollout.npz").exists()
    assert resume(path, "--task", str(TURNING)) == 0
    assert content(path) == content(whole)


def test_costs_of_steps_in_a_run_folder_are_those_of_their_rewards(begin) -> None:
    run = RunFolder.open(begin("run", 1))
    costs = run.read_arrays(1, "rollout")["costs"]
    assert costs.sum() == pytest.approx(run.result(1)["real_cost"])


@pytest.mark.slow
def test_its_policy_is_recorded_evaluated_and_reported(begin, tmp_path: Path) -> None:
    path = begin("run", 1)
    folder = tmp_path / "records"
    record = ["record", "--policy", str(path), "--seconds", "1.5", "--rollouts", "1", "--quiet"]
    assert main([*record, "--out", str(folder)]) == 0
    assert (folder / "policy-seed0-00.csv").read_text().startswith("time,angle,velocity,torque")
    assert main(["evaluate", str(path), "--episodes", "2", "--json"]) == 0
    assert main(["report", str(path), "--out", str(tmp_path / "report.html")]) == 0
    assert "This cannot be shown" not in (tmp_path / "report.html").read_text()


def test_states_found_in_the_observation_are_not_also_measured_in_part() -> None:
    with pytest.raises(InputError, match="give one of them"):
        replace(CIRCULAR, measured=(0,))
