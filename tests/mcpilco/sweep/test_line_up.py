from __future__ import annotations

import pytest

from mcpilco.sweep import line_up
from mcpilco.typing import RunFolderError
from tests.mcpilco.sweep.folders import trials_of, write_sweep

SEEDS = {k: trials_of([0.1, 0.9]) for k in range(2)}


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        ({"env": "envs:mcpilco/Pendulum-v0"}, "env 'mcpilco/Pendulum-v0', not 'mcpilco/Cart"),
        ({"env_kwargs": {"dt": 0.05}}, "env_kwargs {'dt': 0.05}, not {}"),
        ({"config": {"horizon": 40}}, "horizon 40, not None"),
        ({"fresh_horizon": 60}, "fresh_horizon 60, not None"),
    ],
)
def test_what_is_judged_otherwise_is_left_out_with_the_reason(tmp_path, setting, sentence):
    paths = [write_sweep(tmp_path / "a", SEEDS), write_sweep(tmp_path / "b", SEEDS, **setting)]
    found = line_up(paths)
    assert [run.name for run in found.runs] == ["a"]
    (told,) = found.left_out
    assert told.startswith(f"left out: {paths[1]} is judged otherwise than {paths[0]}: {sentence}")


def test_the_module_of_an_env_is_no_difference(tmp_path):
    paths = [write_sweep(tmp_path / "a", SEEDS)]
    paths.append(write_sweep(tmp_path / "b", SEEDS, env="mcpilco/CartPoleSwingUp-v0"))
    assert len(line_up(paths).runs) == 2


def test_a_foreign_folder_loses_no_other(tmp_path):
    paths = [tmp_path, write_sweep(tmp_path / "a", SEEDS), tmp_path / "none"]
    found = line_up(paths)
    assert [run.name for run in found.runs] == ["a"]
    assert len(found.left_out) == 2


def test_where_nothing_can_be_read_each_folder_says_why(tmp_path):
    with pytest.raises(RunFolderError, match=r"a holds neither.*b holds neither"):
        line_up([tmp_path / "a", tmp_path / "b"])


def test_runs_of_one_setting_and_different_seeds_are_one(tmp_path):
    paths = [
        write_sweep(tmp_path / str(seed), {seed: trials_of([0.5])}, fresh=0) for seed in range(3)
    ]
    paths.append(write_sweep(tmp_path / "other", SEEDS, fresh=0, config={"horizon": None, "x": 1}))
    paths.append(write_sweep(tmp_path / "again", {1: trials_of([0.5])}, fresh=0))
    found = line_up(paths)
    assert [(run.name, list(run.courses)) for run in found.runs] == [
        ("mcpilco", [0, 1, 2]),
        ("other", [0, 1]),
    ]
    assert found.left_out == (
        f"left out: {paths[-1]} has the same setting and seed 1 as {paths[0]}.",
    )


def test_equal_names_are_told_apart_by_their_paths(tmp_path):
    paths = [write_sweep(tmp_path / name, SEEDS) for name in ("a/default", "b/default", "tip")]
    runs = line_up([*paths, paths[0]]).runs
    assert [run.name for run in runs] == ["a/default", "b/default", "tip"]


def test_an_agent_that_was_told_another_task_is_judged_alike_and_the_reader_is_told(tmp_path):
    paths = [write_sweep(tmp_path / "a", SEEDS), write_sweep(tmp_path / "b", SEEDS, task="tip.py")]
    found = line_up(paths)
    assert len(found.runs) == 2
    assert found.cautions == [
        "The agents were given different tasks; all are judged by the env's: "
        "a: by the env, b: tip.py."
    ]


def test_a_reader_is_told_of_other_machines_and_other_numbers_of_rollouts(tmp_path):
    paths = [write_sweep(tmp_path / "a", SEEDS)]
    assert line_up(paths).cautions == []
    paths.append(write_sweep(tmp_path / "b", SEEDS, fresh=10, cpu="Xeon"))
    assert line_up(paths).cautions == [
        "p is of different numbers of fresh rollouts: 10, 100.",
        "CPU seconds are of different machines: Xeon, Zen.",
    ]
