from __future__ import annotations

import dataclasses
import json

import pytest

from mcpilco.config import PRESETS, ModelConfig
from mcpilco.sweep import Failure, Settings, SweepFolder
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
