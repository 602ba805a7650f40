"""Laws of what users give as callbacks: stable-baselines3's see each step of each rollout."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mcpilco.agent import MCPILCO
from mcpilco.logbook import Callback
from mcpilco.logbook.foreign import as_callback
from mcpilco.typing import InputError
from tests.mcpilco.fakes import play
from tests.mcpilco.logbook.test_callbacks import Diary
from tests.mcpilco.point import STEPS, TINY, PointEnv

sb3 = pytest.importorskip("stable_baselines3.common.callbacks")
logger = pytest.importorskip("stable_baselines3.common.logger")
monitor = pytest.importorskip("stable_baselines3.common.monitor")


def learn(callback: Any, trials: int = 2, logger: Any = None) -> MCPILCO:
    agent = MCPILCO("SumOfGaussians", PointEnv(), config=TINY)
    if logger is not None:
        agent.set_logger(logger)
    return agent.learn(agent.timesteps_of(trials), callback)


@pytest.mark.parametrize("given", [None, [], Diary(), [Diary()], (Diary(), Diary())])
def test_as_callback_takes_nothing_one_or_several(given):
    members = [] if given is None else [given] if isinstance(given, Callback) else given
    play(as_callback(given))
    assert all("on_trial_end" in member.notes for member in members)


def test_as_callback_adds_further_ones():
    given, more = Diary(), Diary()
    play(as_callback(given, more))
    assert given.notes == more.notes != []


@pytest.mark.parametrize("stranger", [Callback, "progress", [Callback(), 3], 5])
def test_as_callback_refuses_what_is_no_callback(stranger):
    with pytest.raises(InputError, match="must be a mcpilco.logbook.Callback"):
        as_callback(stranger)


class Seen(sb3.BaseCallback):
    """Notes each call, and the locals of each step; stops at step `last`."""

    def __init__(self, last: int | None = None) -> None:
        super().__init__()
        self.calls: list[str] = []
        self.steps: list[dict[str, Any]] = []
        self.last = last

    def _on_training_start(self) -> None:
        self.calls.append("training_start")

    def _on_rollout_start(self) -> None:
        self.calls.append("rollout_start")

    def _on_step(self) -> bool:
        self.steps.append({**self.locals, "num_timesteps": self.num_timesteps})
        return self.num_timesteps != self.last

    def _on_rollout_end(self) -> None:
        self.calls.append("rollout_end")

    def _on_training_end(self) -> None:
        self.calls.append("training_end")


def test_each_step_of_each_rollout_is_told_in_order() -> None:
    seen, functions = Seen(), []
    agent = learn([seen, lambda locals_, _: functions.append(locals_["rewards"].item())])
    rollouts = ["rollout_start", "rollout_end"] * 3
    assert seen.calls == ["training_start", *rollouts, "training_end"]
    assert [step["num_timesteps"] for step in seen.steps] == list(range(1, 3 * STEPS + 1))
    assert [bool(step["dones"][0]) for step in seen.steps] == ([False] * (STEPS - 1) + [True]) * 3
    last = seen.steps[-1]
    rollout = agent.results[-1].rollout
    assert last["infos"][0]["episode"] == {"r": rollout.rewards.sum(), "l": STEPS}
    np.testing.assert_array_equal(last["new_obs"], rollout.observations[-1:])
    np.testing.assert_array_equal(last["actions"], rollout.inputs[-1:])
    assert last["total_timesteps"] == 3 * STEPS == agent.num_timesteps
    assert functions == [step["rewards"].item() for step in seen.steps]


@pytest.mark.parametrize(
    ("last", "trials"), [(None, 3), (STEPS, 0), (STEPS + 1, 1), (2 * STEPS, 1)]
)
def test_a_callback_that_answers_false_ends_the_learning_behind_its_rollout(
    last: int | None, trials: int
) -> None:
    seen, ours = Seen(last), Diary()
    agent = learn([seen, ours], trials=3)
    assert agent.trials == trials == len(agent.results)
    assert seen.calls[-1] == "training_end"
    assert ours.notes[-1] == "on_training_end"
    assert agent.learn(STEPS).trials == trials + 1  # it can go on


def test_a_callback_of_ours_can_end_the_learning_too() -> None:
    class Enough(Callback):
        def stops(self) -> bool:
            return True

    assert learn([Callback(), Enough()]).trials == 0


def test_callbacks_of_the_library_work(tmp_path: Path) -> None:
    evaluated = sb3.EvalCallback(
        monitor.Monitor(PointEnv(ends_at=STEPS)),
        n_eval_episodes=2,
        eval_freq=STEPS,
        log_path=str(tmp_path),
        best_model_save_path=str(tmp_path),
        verbose=0,
    )
    saved = sb3.CheckpointCallback(save_freq=STEPS, save_path=str(tmp_path))
    episodes = sb3.StopTrainingOnMaxEpisodes(max_episodes=3)
    often = sb3.EveryNTimesteps(STEPS, Seen())
    given = sb3.CallbackList([evaluated, saved, episodes, often, sb3.LogEveryNTimesteps(STEPS)])
    agent = learn(given, trials=5)
    assert agent.trials == 2
    assert np.load(tmp_path / "evaluations.npz")["timesteps"].tolist() == [6, 12, 18]
    assert (tmp_path / "best_model.npz").exists()
    assert len(often.callback.steps) == 3
    again = MCPILCO.load(tmp_path / f"rl_model_{3 * STEPS}_steps.zip")
    np.testing.assert_array_equal(again.predict(np.zeros(2))[0], agent.predict(np.zeros(2))[0])


def test_an_evaluation_can_end_the_learning(tmp_path: Path) -> None:
    reached = sb3.StopTrainingOnRewardThreshold(reward_threshold=-1e9)
    env = monitor.Monitor(PointEnv(ends_at=STEPS))
    given = sb3.EvalCallback(env, reached, eval_freq=2 * STEPS, n_eval_episodes=1, verbose=0)
    assert learn(given, trials=5).trials == 1


def test_a_logger_has_a_row_a_trial_with_our_keys(tmp_path: Path) -> None:
    class Own(sb3.BaseCallback):
        def _on_step(self) -> bool:
            self.logger.record("own/steps", self.num_timesteps)
            return True

    agent = learn(Own(), logger=logger.configure(str(tmp_path), ["csv"]))
    rows = list(csv.DictReader((tmp_path / "progress.csv").read_text().splitlines()))
    assert [row["time/total_timesteps"] for row in rows] == ["12", "18"]
    assert [row["own/steps"] for row in rows] == ["12", "18"]
    for row, result in zip(rows, agent.results, strict=True):
        assert float(row["rollout/real_cost"]) == pytest.approx(result.real_cost)
        assert {"policy/cost", "model/noise_std_0", "rollout/ep_return"} <= set(row)


def test_a_logger_writes_for_tensorboard_too(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    learn(None, trials=1, logger=logger.configure(str(tmp_path), ["tensorboard"]))
    assert list(tmp_path.glob("events.out.tfevents.*"))


def test_callbacks_and_logger_change_nothing_that_is_learned(tmp_path: Path) -> None:
    watched = learn([Seen()], logger=logger.configure(str(tmp_path), ["csv"]))
    alone = learn(None)
    assert [r.real_cost for r in watched.results] == [r.real_cost for r in alone.results]
