from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from mcpilco.sweep.page import BEGIN, END

RUN = Path(__file__).parent.parent.parent / "runs" / "pendulum_swingup" / "run.py"


@pytest.fixture(scope="module")
def run():
    spec = importlib.util.spec_from_file_location("pendulum_swingup_run", RUN)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_run_trains_its_seeds_and_writes_its_page_and_goes_on(
    run, hasty, tmp_path, monkeypatch, capsys
):
    def call(seeds):
        arguments = ["run.py", "--seeds", seeds, "--workers", "1", "--out", str(tmp_path)]
        monkeypatch.setattr(sys, "argv", arguments)
        assert run.main() == 0
        return (tmp_path / "README.md").read_text()

    text = call("0:1")
    assert "| after | 4 s | 8 s | 12 s | 16 s |" in text
    assert "| success of one rollout a policy [%] | 0.0 (0–79) |" in text
    assert "in that of the last trial 0 of 1." in text
    assert "in that of the last trial 0 of 2." in call("0:2")
    assert "1 of 2 seeds are there already." in capsys.readouterr().out


def test_verdict_counts_seeds_that_solved_it_once_and_at_last(run):
    found = [{"success": [True, False]}, {"success": [False, True]}, {"success": [False, False]}]
    text = run.verdict({"by_seed": {str(seed): trials for seed, trials in enumerate(found)}})
    assert "of at least one trial 2 of 3, in that of the last trial 1 of 3." in text


def test_page_of_the_repository_has_its_marked_lines():
    text = (RUN.parent / "README.md").read_text()
    assert text.count(BEGIN) == text.count(END) == 1
