from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest

from mcpilco.cli import main
from mcpilco.config import PRESETS
from mcpilco.sweep import read_run
from mcpilco.typing import RunFolderError
from tests.mcpilco.sweep.folders import trials_of, write_sweep
from tests.mcpilco.sweep.strange import TINY


def test_processor_time_is_that_of_all_trials_so_far(tmp_path):
    path = write_sweep(tmp_path / "a", {3: trials_of([0.1, 0.2, 0.9], cpu_s=2.5)})
    course = read_run(path).courses[3]
    np.testing.assert_array_equal(course.values["cpu_s"], [2.5, 5.0, 7.5])
    np.testing.assert_array_equal(course.experience_s, [3.0, 6.0, 9.0])
    np.testing.assert_array_equal(course.values["p"], [0.1, 0.2, 0.9])


@pytest.mark.parametrize(
    ("shares", "seconds"),
    [([0.9, 0.0], 3.0), ([0.89, 0.95], 6.0), ([0.89, 0.0], math.inf), ([None, None], math.nan)],
)
def test_a_task_is_solved_by_the_first_policy_that_succeeds_nine_times_in_ten(
    tmp_path, shares, seconds
):
    run = read_run(write_sweep(tmp_path / "a", {0: trials_of(shares)}))
    assert run.courses[0].solved_s == pytest.approx(seconds, nan_ok=True)


def test_the_first_success_is_that_of_a_test_rollout(tmp_path):
    rows = trials_of([0.2, 0.8], p=None)
    course = read_run(write_sweep(tmp_path / "a", {0: rows})).courses[0]
    assert course.succeeded_s == 6.0
    assert math.isnan(course.solved_s)


def test_the_amount_of_experience_is_the_median_over_seeds_that_reached_the_trial(tmp_path):
    seeds = {k: trials_of([0.0] * (1 + k), after=3.0 + k) for k in range(3)}
    run = read_run(write_sweep(tmp_path / "a", seeds))
    np.testing.assert_array_equal(run.amounts, [4.0, 9.0, 15.0])
    assert run.at(9.0, "return") == {1: 20.0, 2: 20.0}
    assert run.at(15.0, "return") == {2: 30.0}


def test_damaged_seeds_and_those_that_broke_off_are_named_and_lose_no_other(tmp_path):
    path = write_sweep(tmp_path / "a", {k: trials_of([0.5]) for k in range(4)})
    seeds = path / "seeds"
    (seeds / "0001.json").write_text('{"seed": 1, "trials": [{"cpu_s": 3}]')
    (seeds / "0002.json").write_text('{"seed": 2, "trials": [{"cpu_s": 3}]}')
    (seeds / "0003.json").write_text('{"seed": 3, "trials": 7}')
    (seeds / "0010.txt").write_text("it was killed\n\nat noon")
    run = read_run(path)
    assert list(run.courses) == [0]
    assert [f"000{k}.json is left out" in run.problems[k - 1] for k in (1, 2, 3)] == [True] * 3
    assert run.problems[3] == f"{path}: seed 10 broke off: it was killed"


@pytest.mark.parametrize(
    ("about", "sentence"),
    [
        ({"format": 9}, "has format 9, this mcpilco reads 1"),
        ({"config": 3}, "is damaged: its setting lacks"),
        ({"env": None}, "is damaged: its setting lacks"),
    ],
)
def test_a_sweep_that_cannot_be_read_says_why(tmp_path, about, sentence):
    path = write_sweep(tmp_path / "a", {0: trials_of([0.5])}, **about)
    with pytest.raises(RunFolderError, match=sentence):
        read_run(path)


def test_a_sweep_without_results_has_nothing_to_compare(tmp_path):
    with pytest.raises(RunFolderError, match="holds no finished trial yet"):
        read_run(write_sweep(tmp_path / "a", {}))


def test_a_folder_of_sweeps_names_them(tmp_path):
    write_sweep(tmp_path / "one", {})
    with pytest.raises(RunFolderError, match="name its folders, which do: one."):
        read_run(tmp_path)
    with pytest.raises(RunFolderError, match="name a folder that `mcpilco sweep` or"):
        read_run(tmp_path / "one" / "seeds")


def test_a_training_is_read_as_the_sweep_of_its_seed(tmp_path, monkeypatch, unchecked_shapes):
    hasty = dataclasses.replace(TINY, engine="eager")
    preset = dataclasses.replace(PRESETS["default"], config=hasty)
    monkeypatch.setitem(PRESETS, "default", preset)
    common = ["--horizon", "5", "--trials", "2", "--quiet"]
    assert main(["train", "--seed", "3", "--out", str(tmp_path / "run"), *common]) == 0

    from mcpilco.sweep import Settings, sweep
    from tests.mcpilco.test_sweep import HereEngine

    about = json.loads((tmp_path / "run" / "config.json").read_text())
    config = dataclasses.replace(hasty, horizon=5)
    settings = Settings(f"envs:{about['env']}", about["env_kwargs"], "default", config, 2, 0)
    sweep(settings, [3], tmp_path / "sweep", HereEngine())

    run, swept = read_run(tmp_path / "run"), read_run(tmp_path / "sweep")
    assert run.protocol == swept.protocol
    assert run.config == swept.config
    for name in ("success", "return", "time_up_s", "mean_abs_cart_m", "p"):
        here, there = (r.courses[3].values[name] for r in (run, swept))
        np.testing.assert_array_equal(here, there)
    assert np.isfinite(run.courses[3].values["return"]).all()
