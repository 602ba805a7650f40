from __future__ import annotations

import dataclasses
import io
import json
import sys

import pytest
from rich.console import Console

from mcpilco.logbook.callbacks import (
    Callback,
    CallbackList,
    JsonLines,
    TensorBoard,
    trial_values,
)
from mcpilco.logbook.progress import Progress
from mcpilco.typing import InputError, RunFolderError
from tests.mcpilco.fakes import make_result, play

METHODS = [name for name in vars(Callback) if name.startswith("on_")] + ["close"]


class Diary(Callback):
    """Notes the names of the methods called."""

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
    assert lines[0] == "exploration: 0.6 s of random inputs"
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
