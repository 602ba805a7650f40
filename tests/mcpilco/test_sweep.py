"""The function `sweep` and the command `mcpilco sweep`, their jobs done in this process."""

from __future__ import annotations

import json

import pytest

import mcpilco.sweep
from mcpilco.cli import main
from mcpilco.config import PRESETS, Preset
from mcpilco.sweep import Failure, Settings, parse_seeds, sweep
from mcpilco.sweep.engines import attempt
from mcpilco.typing import InputError
from tests.mcpilco.sweep.strange import HERE, TINY

POINT = Settings(f"{HERE}:Sweep/Point-v0", config=TINY, trials=1, fresh=2)


class HereEngine:
    """Does jobs in this process; loses those of `lost`, and is interrupted at `interrupt`."""

    def __init__(self, lost=(), interrupt=None):
        self.lost, self.interrupt, self.done = lost, interrupt, []

    def run(self, jobs, on_result):
        for seed, job in jobs.items():
            if seed == self.interrupt:
                raise KeyboardInterrupt
            self.done.append(seed)
            on_result(seed, Failure("it was killed") if seed in self.lost else attempt(job))


def test_a_sweep_goes_on_where_it_was_stopped(tmp_path):
    first, second = HereEngine(interrupt=2), HereEngine()
    with pytest.raises(KeyboardInterrupt):
        sweep(POINT, range(3), tmp_path, first)
    assert json.loads((tmp_path / "summary.json").read_text())["seeds"] == [0, 1]
    summary = sweep(POINT, range(4), tmp_path, second)
    assert (first.done, second.done) == ([0, 1], [2, 3])
    assert summary["seeds"] == [0, 1, 2, 3]


def test_a_lost_seed_is_reported_and_tried_again(tmp_path):
    summary = sweep(POINT, range(3), tmp_path, HereEngine(lost=[1]))
    assert summary["seeds"] == [0, 2]
    assert summary["failed"] == {"1": "it was killed"}
    again = HereEngine()
    assert sweep(POINT, range(3), tmp_path, again)["failed"] == {}
    assert again.done == [1]


def test_each_result_is_on_disk_when_it_is_told(tmp_path):
    def on_result(seed, outcome):
        told.append(json.loads((tmp_path / "seeds" / f"000{seed}.json").read_text()) == outcome)

    told = []
    sweep(POINT, range(2), tmp_path, HereEngine(), on_result)
    assert told == [True, True]


def test_a_sweep_in_pieces_is_the_sweep_in_one(tmp_path):
    for seeds in ([1], [0, 1]):
        sweep(POINT, seeds, tmp_path / "pieces", HereEngine())
    sweep(POINT, [0, 1], tmp_path / "one", HereEngine())
    found = []
    for name in ("pieces", "one"):
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        found.append([(row["return"], row["predicted_cost"]) for row in summary["trials"]])
    assert found[0] == found[1]


# The command --------------------------------------------------------------------------------------


@pytest.fixture
def here(monkeypatch):
    """The engine that works in this process, in place of the local one, and hasty presets."""
    engine = HereEngine()
    monkeypatch.setattr(mcpilco.sweep, "LocalEngine", lambda workers: engine)
    for name, preset in PRESETS.items():
        hasty = Preset(preset.summary, TINY, preset.env_kwargs)
        monkeypatch.setitem(PRESETS, name, hasty)
    return engine


RUN = ["--seeds", "0:3", "--trials", "2", "--horizon", "5", "--fresh", "2"]


def test_command_ends_with_a_table_and_the_folder(tmp_path, here, capsys):
    assert main(["sweep", *RUN, "--out", str(tmp_path)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines[:3]] == ["seed 0", "seed 1", "seed 2"]
    assert any("(0–56)" in line for line in lines)
    assert not any("…" in line for line in lines)
    assert lines[-1] == f"Sweep folder: {tmp_path}"
    assert "Seeds: 3; failed: none" in (tmp_path / "table.md").read_text()


@pytest.mark.slow
def test_command_repeated_does_no_seed_again(tmp_path, here, capsys):
    for _ in range(2):
        assert main(["sweep", *RUN, "--out", str(tmp_path)]) == 0
    assert here.done == [0, 1, 2]
    assert "3 of 3 seeds are there already." in capsys.readouterr().out


def test_command_with_a_lost_seed_ends_with_1_and_can_be_repeated(tmp_path, here, capsys):
    here.lost = [1]
    assert main(["sweep", *RUN, "--out", str(tmp_path)]) == 1
    assert "seed 1 failed: it was killed" in capsys.readouterr().out
    assert main(["sweep", *RUN[2:], "--seeds", "0,2", "--out", str(tmp_path)]) == 0
    here.lost = []
    assert main(["sweep", *RUN, "--out", str(tmp_path)]) == 0
    assert here.done == [0, 1, 2, 1]


def test_command_interrupted_says_what_is_saved(tmp_path, here, capsys):
    here.interrupt = 1
    assert main(["sweep", *RUN, "--out", str(tmp_path)]) == 130
    assert "interrupted; 1 of 3 seeds are saved" in capsys.readouterr().err


@pytest.mark.slow
def test_quiet_command_prints_the_table_alone(tmp_path, here, capsys):
    assert main(["sweep", *RUN, "--quiet", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "seed 0" not in out
    assert "success" in out


def test_env_without_success_shows_its_return(tmp_path, here, capsys):
    argv = ["--env", POINT.env, "--seeds", "0:2", "--trials", "1", "--fresh", "2"]
    assert main(["sweep", *argv, "--out", str(tmp_path)]) == 0
    assert "success -, return" in capsys.readouterr().out
    (trial,) = json.loads((tmp_path / "summary.json").read_text())["trials"]
    assert trial["success"] is trial["p"] is None
    assert trial["return"]["n"] == trial["fresh_return"]["n"] == 2


@pytest.mark.slow
def test_folder_holds_the_preset_and_its_cart_pole(tmp_path, here):
    argv = ["--preset", "tro2022", "--seeds", "0:1", "--trials", "1", "--fresh", "0"]
    assert main(["sweep", *argv, "--out", str(tmp_path)]) == 0
    settings = json.loads((tmp_path / "sweep.json").read_text())
    assert settings["env_kwargs"]["dt"] == PRESETS["tro2022"].env_kwargs["dt"]
    assert (settings["preset"], settings["trials"], settings["fresh"]) == ("tro2022", 1, 0)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--seeds", "3:3"], "--seeds must be like 0:30"),
        (["--env", "nowhere/Nothing-v0"], "Namespace nowhere not found"),
        (["--trials", "0"], "trials must be at least 1, got 0"),
        (["--fresh", "-1"], "fresh must not be negative, got -1"),
        (["--horizon", "0"], "horizon must be >= 1 step, got 0"),
        (["--engine", "ray", "--workers", "2"], "--workers is for the engine local"),
    ],
)
def test_wrong_arguments_are_refused_before_a_folder_is_made(tmp_path, capsys, arguments, sentence):
    assert main(["sweep", *arguments, "--out", str(tmp_path / "sweep")]) == 2
    err = capsys.readouterr().err
    assert err.startswith("mcpilco: error: ")
    assert sentence in err
    assert not (tmp_path / "sweep").exists()


@pytest.mark.slow
def test_folder_with_other_settings_is_refused(tmp_path, here, capsys):
    assert main(["sweep", *RUN, "--out", str(tmp_path)]) == 0
    assert main(["sweep", *RUN, "--fresh", "3", "--out", str(tmp_path)]) == 2
    assert "other settings: fresh was 2, now 3; name another" in capsys.readouterr().err


def test_seeds_are_read():
    assert list(parse_seeds("2:5")) == [2, 3, 4]
    assert list(parse_seeds("7,3,7")) == [3, 7]
    assert list(parse_seeds("4")) == [4]
    assert list(parse_seeds("5,2:4,3,8:9")) == [2, 3, 5, 8]


@pytest.mark.parametrize(
    "text", ["", "a", "5:2", "1:2:3", "-1:3", "1,,2", "0.5", "4294967296", "1,3:3", "0:4,-1"]
)
def test_seeds_that_are_none_are_refused(text):
    with pytest.raises(InputError, match="--seeds must be like"):
        parse_seeds(text)
