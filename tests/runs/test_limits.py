from __future__ import annotations

import json
import sys

import pytest


@pytest.mark.slow  # trains twice
def test_quick_runs_of_both_kinds_fill_one_table(run, tmp_path, monkeypatch):
    words = ["run.py", "--quick", "--out", str(tmp_path), "--seeds", "3", "--trials", "1"]
    for more in ([], ["--free"]):
        monkeypatch.setattr(sys, "argv", [*words, *more])
        run.main()
    found = json.loads((tmp_path / "results" / "limited" / "3.json").read_text())
    assert not any(found["explored"])
    assert len(found["crossed"]) == len(found["failed"]) == 1
    assert len(found["furthest_m"]) == 1 + len(found["explored"])
    assert max(found["furthest_m"]) < 0.5
    text = (tmp_path / "README.md").read_text()
    assert "| within the limits | 1 |" in text
    assert "| without limits | 1 |" in text


def test_a_policy_counts_by_the_experience_behind_it(run):
    result = {"success": [False, True, False], "experience_s": [3.0, 6.0, 9.0]}
    assert [run.within(result, seconds) for seconds in (2.0, 3.0, 6.0, 8.9, 9.0)] == [
        *(False, False, True, True, False)
    ]
