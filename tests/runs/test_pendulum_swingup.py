from __future__ import annotations

import sys

import pytest


@pytest.mark.slow
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
