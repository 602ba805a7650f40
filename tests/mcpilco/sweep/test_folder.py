"""The folder of a sweep, and its summary."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from mcpilco.config import PRESETS, ModelConfig
from mcpilco.sweep import Failure, Settings, SweepFolder
from mcpilco.sweep.folder import conclusion, markdown, mean, rate, spread, summarise, summary_table
from mcpilco.typing import RunFolderError

SETTINGS = Settings("Any-v0", {"dt": 0.1}, trials=2)


def result(seed, trials=2):
    return {"format": 1, "seed": seed, "trials": [{}] * trials}


def test_results_are_found_again_by_seed(tmp_path):
    folder = SweepFolder(tmp_path / "a" / "b", SETTINGS)
    for seed in (12345, 7):
        folder.write(seed, result(seed))
    assert list(SweepFolder(folder.path, SETTINGS).results()) == [7, 12345]
    assert (folder.path / "seeds" / "0007.json").is_file()


def test_a_sweep_of_no_results_goes_on_in_a_copy_that_lost_its_empty_folder(tmp_path):
    SweepFolder(tmp_path, SETTINGS)
    (tmp_path / "seeds").rmdir()
    SweepFolder(tmp_path, SETTINGS).write(7, result(7))
    assert list(SweepFolder(tmp_path, SETTINGS).results()) == [7]


@pytest.mark.parametrize("content", ["", "{", "[]", '{"seed": 1}', '{"seed": 1, "trials": [1, 2]}'])
def test_a_damaged_result_counts_as_missing(tmp_path, content):
    folder = SweepFolder(tmp_path, SETTINGS)
    folder.write(0, result(0))
    (tmp_path / "seeds" / "0001.json").write_text(content)
    assert list(folder.results()) == [0]


def test_a_result_of_fewer_trials_counts_as_missing(tmp_path):
    folder = SweepFolder(tmp_path, SETTINGS)
    folder.write(1, result(1, trials=1))
    assert not folder.results()


def test_a_failure_is_kept_until_the_seed_succeeds(tmp_path):
    folder = SweepFolder(tmp_path, SETTINGS)
    folder.write(4, Failure("ValueError: no luck", "Traceback ..."))
    assert folder.failures() == {4: "ValueError: no luck"}
    assert "Traceback" in (tmp_path / "seeds" / "0004.txt").read_text()
    folder.write(4, result(4))
    assert not folder.failures()
    assert not (tmp_path / "seeds" / "0004.txt").exists()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"trials": 3}, "trials was 2, now 3"),
        ({"env_kwargs": {"dt": 0.2}}, "env_kwargs was another, now another"),
        ({"config": PRESETS["thesis"].config}, "config"),
    ],
)
def test_other_settings_are_refused_by_name(tmp_path, change, sentence):
    SweepFolder(tmp_path, SETTINGS)
    with pytest.raises(RunFolderError, match="holds a sweep with other settings") as caught:
        SweepFolder(tmp_path, dataclasses.replace(SETTINGS, **change))
    assert sentence in str(caught.value)


def test_every_preset_is_recognised_again(tmp_path):
    for name, preset in PRESETS.items():
        settings = Settings("Any-v0", preset.env_kwargs, name, preset.config)
        for _ in range(2):
            SweepFolder(tmp_path / name, settings)


def test_a_sweep_begun_before_an_entry_existed_goes_on_at_its_default(tmp_path):
    SweepFolder(tmp_path, SETTINGS)
    about = json.loads((tmp_path / "sweep.json").read_text())
    del about["config"]["model"]["sampling"], about["config"]["model"]["path_features"]
    (tmp_path / "sweep.json").write_text(json.dumps(about))
    SweepFolder(tmp_path, SETTINGS)
    config = dataclasses.replace(SETTINGS.config, model=ModelConfig(sampling="path"))
    with pytest.raises(RunFolderError, match="config was another"):
        SweepFolder(tmp_path, dataclasses.replace(SETTINGS, config=config))


@pytest.mark.parametrize("config", [None, 5, {"models": {}}, {"horizon": "long"}])
def test_settings_that_cannot_be_read_are_other_settings(tmp_path, config):
    SweepFolder(tmp_path, SETTINGS)
    about = json.loads((tmp_path / "sweep.json").read_text())
    (tmp_path / "sweep.json").write_text(json.dumps({**about, "config": config}))
    with pytest.raises(RunFolderError, match="holds a sweep with other settings"):
        SweepFolder(tmp_path, SETTINGS)


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "thesis.pdf").touch()
    with pytest.raises(RunFolderError, match="holds no sweep"):
        SweepFolder(tmp_path, SETTINGS)


def test_an_unwritable_folder_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RunFolderError, match="cannot be written"):
        SweepFolder(tmp_path / "file" / "sweep", SETTINGS)


def make_result(seed, successes, cpu_s=10.0):
    trials = [
        {
            "trial": trial,
            "experience_s": 3.0 * trial,
            "success": success,
            "p": None if success is None else 0.9 * success,
            "return": float(seed),
            "fresh_return": 1.0,
            "time_up_s": None if success is None else 1.5,
            "mean_abs_cart_m": None if success is None else 0.2,
            "predicted_cost": 10.0,
            "real_cost": 11.0,
            "starts": 1,
            "policy_steps": 500,
            "cpu_s": cpu_s,
            "wall_s": 12.0,
        }
        for trial, success in enumerate(successes, start=1)
    ]
    machine = {"cpu": "Zen", "cores": 2}
    return {"seed": seed, "trials": trials, "machine": machine, "versions": {"python": "3.11"}}


def test_rate_has_wilsons_interval():
    """Closed form: (s + z^2 / 2 +- z sqrt(s (n - s) / n + z^2 / 4)) / (n + z^2)."""
    found = rate([True] * 27 + [False] * 3 + [None])
    z, n, s = 1.959963984540054, 30, 27
    middle, half = s + z**2 / 2, z * np.sqrt(s * (n - s) / n + z**2 / 4)
    assert found["n"] == 30
    assert found["rate"] == pytest.approx(0.9)
    assert found["low"] == pytest.approx((middle - half) / (n + z**2))
    assert found["high"] == pytest.approx((middle + half) / (n + z**2))
    assert rate([None]) is None


def test_bootstrap_interval_has_the_width_of_the_normal_one():
    values = np.random.default_rng(0).normal(0.5, 0.1, 100)
    found = mean(values)
    half = 1.96 * values.std() / 10
    assert found["mean"] == pytest.approx(values.mean())
    assert found["low"] == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found["high"] == pytest.approx(values.mean() + half, abs=0.1 * half)
    assert found == mean(values)


@pytest.mark.filterwarnings("error")
def test_intervals_exist_where_all_seeds_agree_and_not_from_one_seed():
    assert mean([1.0, 1.0]) == {"n": 2, "mean": 1.0, "low": 1.0, "high": 1.0}
    assert mean([1.0]) == {"n": 1, "mean": 1.0, "low": None, "high": None}
    assert rate([True])["low"] < 0.5
    assert mean([None]) is spread([]) is None


def test_spread_leaves_out_what_is_not_told():
    found = spread([3.0, None, 1.0, 2.0, 5.0, 4.0])
    assert (found["n"], found["q1"], found["median"], found["q3"]) == (5, 2.0, 3.0, 4.0)
    assert found["mean"] == pytest.approx(3.0)
    assert found["std"] == pytest.approx(np.sqrt(2.5))


def test_summary_of_seeds():
    results = {
        0: make_result(0, [False, True]),
        1: make_result(1, [False, False], cpu_s=20.0),
        2: make_result(2, [True, True], cpu_s=30.0),
    }
    found = summarise(results, {9: "ValueError: no luck"})
    assert [trial["experience_s"] for trial in found["trials"]] == [3.0, 6.0]
    assert [trial["success"]["rate"] for trial in found["trials"]] == [1 / 3, 2 / 3]
    assert found["trials"][1]["p"]["mean"] == pytest.approx(0.6)
    assert found["solved"]["rate"] == 2 / 3
    assert found["run"]["cpu_s"]["median"] == 40.0
    assert found["by_seed"]["1"]["success"] == [False, False]
    assert found["seeds"] == [0, 1, 2]
    assert found["failed"] == {"9": "ValueError: no luck"}
    assert len(found["machines"]) == 1
    assert json.loads(json.dumps(found)) == found


def test_table_has_a_row_a_trial_and_blanks_where_the_env_does_not_tell():
    _, told = summary_table(summarise({0: make_result(0, [True, False])}, {}))
    assert [row[0] for row in told] == ["3", "6"]
    assert [row[1] for row in told] == ["100.0 (21–100)", "0.0 (0–79)"]
    header, (row,) = summary_table(summarise({0: make_result(0, [None])}, {}))
    cells = dict(zip(header, row, strict=True))
    blank = {"success [%]", "p [%]", "time up [s]", "mean abs cart [m]"}
    assert {name for name, cell in cells.items() if not cell} == blank


def test_no_seed_gives_an_empty_table():
    found = summarise({}, {1: "lost"})
    assert summary_table(found)[1] == []
    assert conclusion(found) == "Seeds: 0; failed: seed 1; no CPU seconds a training."


def test_markdown_has_a_bar_around_every_cell():
    assert markdown(("a", "b"), [("1", "")]) == "| a | b |\n| --- | --- |\n| 1 |  |\n"
