from __future__ import annotations

import dataclasses
import importlib.util
import sys
from pathlib import Path

import pytest

from baselines.pilco import PRESETS
from mcpilco.sweep.page import BEGIN, END
from tests.baselines.pilco.models import TINY

RUN = Path(__file__).parent.parent.parent / "runs" / "cartpole_comparison" / "run.py"


@pytest.fixture(scope="module")
def run():
    before = list(sys.path)
    spec = importlib.util.spec_from_file_location("cartpole_comparison_run", RUN)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]
    sys.path[:] = before


@pytest.fixture
def hasty_pilco(monkeypatch):
    for name, preset in PRESETS.items():
        config = dataclasses.replace(TINY, cost=preset.config.cost)
        monkeypatch.setitem(PRESETS, name, dataclasses.replace(preset, config=config))


def test_all_agents_learn_from_the_same_seeds_and_stand_in_one_table(
    run, hasty, hasty_pilco, tmp_path, monkeypatch, capsys
):
    arguments = ["run.py", "--seeds", "0:1", "--workers", "1", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", arguments)
    monkeypatch.setattr(run, "TRIALS", 1)
    for _ in range(2):
        assert run.main() == 0
    assert capsys.readouterr().out.count("1 of 1 seeds are there already.") == 3
    page = (tmp_path / "README.md").read_text()
    for row in ("PILCO, thesis", *(f"`{name}`, one rollout a policy, 1 seed" for name in run.ROWS)):
        assert f"| {row} |" in page
    assert page.count("| after | 3 s | 6 s | 9 s | 12 s |") == 3


def test_page_of_the_repository_has_its_marked_lines():
    text = (RUN.parent / "README.md").read_text()
    assert text.count(BEGIN) == text.count(END) == 1
