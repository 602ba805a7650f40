import csv
import dataclasses
import io
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from mcpilco.agent import MCPILCO
from mcpilco.logbook.callbacks import (
    Callback,
    CallbackList,
    JsonLines,
    TensorBoard,
    as_callback,
    trial_values,
)
from mcpilco.logbook.progress import Progress
from mcpilco.typing import InputError, RunFolderError
from tests.mcpilco.fakes import make_result, play
from tests.mcpilco.point import STEPS, TINY, PointEnv

METHODS = [name for name in vars(Callback) if name.startswith("on_")] + ["close"]


class Diary(Callback):
    """

    from __future__ import annotations
    Notes the names of the methods called."""

    def __init__(self, notes=None, name=""):
        self.notes = [] if notes is None else notes
        for method in METHODS:
            setattr(self, method, lambda *_, m=method: self.notes.append(name + m))


class Broken(Callback):
    def on_trial_end(self, result):
        raise ZeroDivisionError


def test_base_callback_does_nothing():
    play(Callback())
    Callback().close()


def test_list_passes_every_event_to_all_in_order():
    alone, notes = Diary(), []
    play(alone)
    alone.close()
    both = CallbackList([Diary(notes, "a."), Diary(notes, "b.")])
    play(both)
    both.close()
    assert set(METHODS) == set(alone.notes)
    assert notes == [f"{who}.{event}" for event in alone.notes for who in "ab"]


def test_error_in_a_callback_is_not_swallowed():
    with pytest.raises(ZeroDivisionError):
        play(CallbackList([Callback(), Broken()]))


def test_trial_values_leave_out_what_the_env_does_not_tell():
    told, untold = trial_values(make_result()), trial_values(make_result(told=False))
    assert set(told) - set(untold) == {
        "rollout/success",
        "rollout/time_up_s",
        "rollout/mean_abs_cart_m",
    }
    assert told["rollout/success"] == 1.0


# JSON lines ---------------------------------------------------------------------------------------


def strict(text: str) -> dict:
    def refuse(constant):
        raise ValueError(constant)

    return json.loads(text, parse_constant=refuse)


def test_json_lines_hold_every_event_of_each_trial(tmp_path):
    path = tmp_path / "steps.jsonl"
    play(JsonLines(path), trials=2)
    lines = [strict(line) for line in path.read_text().splitlines()]
    assert [line["time/trial"] for line in lines] == [1] * 5 + [2] * 5
    assert [line.get("time/step") for line in lines[:5]] == [None, 1, 2, 3, None]
    assert lines[1]["policy/cost"] == 5.0
    assert lines[1]["policy/gradient_norm"] is None  # NaN is no JSON
    assert lines[4]["rollout/real_cost"] == make_result(1).real_cost


def test_json_lines_are_on_disk_before_the_training_ends(tmp_path):
    callback = JsonLines(tmp_path / "steps.jsonl")
    callback.on_training_start(None, 1)
    callback.on_trial_start(1)
    callback.on_policy_step(1, 3, {"policy/cost": 2.0})
    assert strict((tmp_path / "steps.jsonl").read_text())["policy/cost"] == 2.0
    callback.close()


def test_json_lines_name_a_folder_that_is_missing(tmp_path):
    with pytest.raises(RunFolderError, match="cannot write"):
        JsonLines(tmp_path / "missing" / "steps.jsonl").on_training_start(None, 1)


# TensorBoard --------------------------------------------------------------------------------------


def test_tensorboard_counts_steps_over_all_trials(tmp_path):
    accumulator = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator")
    play(TensorBoard(tmp_path), trials=2)
    events = accumulator.EventAccumulator(str(tmp_path))
    events.Reload()
    assert [event.step for event in events.Scalars("policy/cost")] == [1, 2, 3, 4, 5, 6]
    assert [event.step for event in events.Scalars("rollout/real_cost")] == [1, 2]


def test_missing_tensorboard_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    with pytest.raises(InputError, match="pip install tensorboard"):
        TensorBoard(tmp_path)


# Progress -----------------------------------------------------------------------------------------


def console(terminal: bool) -> Console:
    return Console(file=io.StringIO(), force_terminal=terminal, width=140)


def test_progress_writes_one_line_a_trial_where_there_is_no_terminal():
    screen = console(terminal=False)
    play(Progress(screen), trials=2)
    lines = screen.file.getvalue().splitlines()
    assert lines[0] == "exploration: 0.6 s"
    assert len(lines) == 3
    assert lines[1].startswith("trial 1, experience [s] 0.6, predicted cost 3.33 ± 0.50, real cost")
    assert "success yes" in lines[1]
    assert "\x1b" not in screen.file.getvalue()


def test_progress_marks_what_the_env_does_not_tell():
    screen = console(terminal=False)
    play(Progress(screen), trials=1, told=False)
    assert "success -, GP noise" in screen.file.getvalue()


def test_progress_shows_the_measures_of_the_env():
    screen = console(terminal=False)
    play(Progress(screen), trials=1)
    assert "success yes, time up [s] 0.30, mean abs cart [m] 0.25" in screen.file.getvalue()


def test_progress_draws_a_table_and_a_bar_on_a_terminal():
    screen = console(terminal=True)
    progress = Progress(screen)
    progress.on_training_start(None, 4)
    progress.on_trial_start(2)
    progress.on_policy_step(2, 3, {"policy/cost": 7.25})
    progress._live.refresh()
    text = screen.file.getvalue()
    assert "trial 2 of 4: searching the policy, cost 7.25" in text
    assert "2/3" in text
    progress.on_trial_end(make_result(2))
    progress.close()
    text = screen.file.getvalue()
    assert "±0.50" in text
    assert "[s]" in text  # a unit, not markup


LARGE = {
    "predicted_cost": 123456.789,
    "predicted_cost_std": 9876.54,
    "real_cost": 98765.4321,
    "experience_s": 123456.7,
    "wall_s": 86399.94,
    "noise_std": (0.0123, 0.000456, 12.3, 1.2e-05, 3210.0, 0.5, 0.25),
}


@pytest.mark.parametrize("values", [{}, LARGE])
def test_progress_fits_eighty_columns_with_all_numbers_whole(values: dict) -> None:
    """However many numbers there are: a column that does not fit whole is left out."""
    screen = Console(file=io.StringIO(), force_terminal=False, color_system=None, width=80)
    progress = Progress(screen)
    progress.on_training_start(None, 4)
    result = dataclasses.replace(make_result(1), **values)
    many = {f"measure_{k}_of_a_thing_m": 1234.5 for k in range(6)}
    for outcome in (result.outcome, result.outcome | many):
        told = dataclasses.replace(
            result, rollout=dataclasses.replace(result.rollout, outcome=outcome)
        )
        progress.on_trial_end(told)
        screen.file.truncate(screen.file.seek(0))
        screen.print(progress._table)
        text = screen.file.getvalue()
        assert max(map(len, text.splitlines())) <= 80
        assert "…" not in text
        for name in ("experience [s]", "predicted cost", "real cost", "wall [s]"):
            numbers = progress._rows[-1][name].replace("± ", "±").split()
            assert {*numbers} <= {*text.split()}, name
    assert "more is in metrics.csv" in text


def test_progress_has_a_bar_for_the_fit_and_one_for_the_whole_run() -> None:
    screen = console(terminal=True)
    progress = Progress(screen)
    progress.on_training_start(None, 4)
    progress.on_trial_start(2)
    progress.on_fit_step(30, 200)
    progress._live.refresh()
    assert "trial 2 of 4: fitting the models" in screen.file.getvalue()
    assert "30/200" in screen.file.getvalue()
    progress.on_policy_step(3, 4, {})
    assert [task.completed for task in progress._bar.tasks] == [1.75, 3]
    progress.on_trial_end(make_result(2))
    assert progress._bar.tasks[0].completed == 2
    progress.close()


@pytest.mark.parametrize("end", ["on_training_end", "close"])
def test_progress_gives_the_cursor_back(end):
    screen = console(terminal=True)
    progress = Progress(screen)
    progress.on_training_start(None, 1)
    assert screen.file.getvalue().rfind("\x1b[?25l") >= 0
    getattr(progress, end)()
    getattr(progress, end)()
    text = screen.file.getvalue()
    assert text.rfind("\x1b[?25h") > text.rfind("\x1b[?25l")


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
    ("last", "trials"),
    [
        (None, 3),
        pytest.param(STEPS, 0, marks=pytest.mark.slow),
        (STEPS + 1, 1),
        (2 * STEPS, 1),
    ],
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
