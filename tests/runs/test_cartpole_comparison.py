from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import pytest

import mcpilco.sweep
from baselines.pilco import PRESETS
from tests.baselines.pilco.models import TINY
from tests.mcpilco.test_sweep import HereEngine

TRAINED = ("mcpilco", "pilco", "pilco-tip")


@pytest.fixture
def hasty_pilco(monkeypatch):
    for name, preset in PRESETS.items():
        config = dataclasses.replace(TINY, cost=preset.config.cost)
        monkeypatch.setitem(PRESETS, name, dataclasses.replace(preset, config=config))


@pytest.fixture
def command(run, hasty, hasty_pilco, tmp_path, monkeypatch, unchecked_shapes):
    """Runs the command in this process, and returns the page."""
    engine = HereEngine()
    monkeypatch.setattr(mcpilco.sweep, "LocalEngine", lambda workers: engine)
    monkeypatch.setattr(run, "TRIALS", 1)
    monkeypatch.setattr(run, "FRESH", 3)

    def command(*arguments):
        monkeypatch.setattr(sys, "argv", ["run.py", "--out", str(tmp_path), *arguments])
        assert run.main() == 0
        return (tmp_path / "README.md").read_text()

    return command


@pytest.mark.slow  # trains, if quickly
def test_all_agents_learn_from_the_same_seeds_and_stand_in_one_table(command, capsys, tmp_path):
    pages = [command("--seeds", "20:21") for _ in range(2)]
    assert capsys.readouterr().out.count("1 of 1 seeds are there already.") == 3
    assert pages[0] == pages[1]
    for row in ("PILCO, thesis", *(f"`{name}`, one rollout a policy, 1 seed" for name in TRAINED)):
        assert f"| {row} |" in pages[0]
    assert pages[0].count("| after | 3 s | 6 s | 9 s | 12 s |") == 3
    for picture in ("cartpole-trials.png", "cartpole-experience.png"):
        assert f"]({picture})" in pages[0]
        assert (tmp_path / picture).read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
@pytest.mark.xdist_group("compiled moments")  # which it compiles
def test_what_learns_without_a_model_stands_beside_them_at_its_amounts(
    run, command, monkeypatch, tmp_path
):
    """PILCO in place of SAC: any algorithm may be judged after amounts of experience."""
    row = run.Row("pilco", amounts=(6, 9))
    assert row.seeds == "20:25"
    monkeypatch.setattr(run, "ROWS", {"sac": row})
    monkeypatch.setattr(run.tables, "AMOUNTS", {6: "6 s", 60: "1 min"})
    page = command("--rows", "sac", "--seeds", "21", "--env", "mujoco")
    assert "### `mcpilco/MujocoCartPoleSwingUp-v0`" in page
    assert "PILCO, thesis" not in page  # it has no figures for MuJoCo
    line = next(line for line in page.splitlines() if line.startswith("| `sac` | 1 |"))
    told = [bool(cell.strip()) for cell in line.split("|")[3:-1]]
    assert told == [True, False]  # 6 s, the data of the policy that was tried within 9 s
    assert not any((tmp_path / "results" / "mujoco" / "sac-checkpoints").iterdir())


@pytest.mark.slow
def test_a_seed_that_broke_off_keeps_its_checkpoint_and_is_listed(run, command, monkeypatch):
    monkeypatch.setattr(run, "ROWS", {"sac": run.Row("pilco", amounts=(6,))})
    engine = HereEngine(lost=[21])
    monkeypatch.setattr(mcpilco.sweep, "LocalEngine", lambda workers: engine)
    with pytest.raises(AssertionError):  # ends with 1
        command("--rows", "sac", "--seeds", "20:22")
    assert "`cartpole/sac`, seed 21 broke off: it was killed" in command(
        "--rows", "sac", "--seeds", "20:21"
    )


def test_no_row_is_tuned_on_the_seeds_that_are_shown(run):
    from all_tables import table_of

    from mcpilco.sweep import parse_seeds

    for name, row in run.ROWS.items():
        seeds = parse_seeds(row.seeds)
        paths = [Path(f"cartpole/{name}/seeds/{seed:04d}.json") for seed in seeds]
        table = table_of("cartpole_comparison", paths[0])
        assert {table.role(path) for path in paths} == {"tested on"}
        assert len(seeds) == (10 if row.amounts else 30)


def test_page_of_the_repository_names_every_row(run, home):
    text = (home / "README.md").read_text()
    assert all(f"`{name}`" in text for name in run.ROWS)
