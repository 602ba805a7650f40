from __future__ import annotations

import sys

import pytest


@pytest.mark.slow  # trains, if quickly
def test_run_trains_its_seeds_and_writes_its_page(run, hasty, tmp_path, monkeypatch):
    arguments = ["--seeds", "0:1", "--workers", "1", "--fresh", "2", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", ["run.py", *arguments])
    assert run.main() == 0
    text = (tmp_path / "README.md").read_text()
    assert "after 12 s: **does not hold** (0.0 %, 1 seeds)." in text
    assert "| after | 3 s | 6 s | 9 s | 12 s |" in text
    assert "| MuJoCo, one rollout a policy | 0.0 (0–79) |" in text
    assert "| mean abs cart [m] |" in text
    assert "Not measured yet" not in text


@pytest.mark.parametrize(("rate", "holds"), [(0.9, "**holds**"), (0.89, "**does not hold**")])
def test_verdict_compares_the_last_trial_with_the_claim(run, rate, holds):
    trials = [{"experience_s": time, "success": {"rate": rate}} for time in (3.0, 12.0)]
    assert holds in run.verdict({"trials": trials, "seeds": list(range(100))})


def test_both_simulations_are_compared_on_the_seeds_that_both_have(run):
    lost, won = ({"success": [done] * 2, "p": [float(done)] * 2} for done in (False, True))
    mujoco = {
        "trials": [{"experience_s": time} for time in (3.0, 6.0)],
        "by_seed": {"0": won, "1": won, "7": lost},
    }
    share = {"rate": 0.25, "low": 0.1, "high": 0.5}
    analytic = {
        "trials": [{"success": share}] * 2,
        "by_seed": {"0": won, "1": lost, "2": lost},
    }
    text = run.comparison(mujoco, analytic)
    assert "| analytic, one rollout a policy, all 3 seeds | 25.0 (10–50) |" in text
    assert "| analytic, one rollout a policy | 50.0 (9–91) |" in text
    assert "| MuJoCo, one rollout a policy | 100.0 (34–100) |" in text
    assert "the 2 seeds that ran in both" in text
    assert (
        "one rollout" not in run.comparison(mujoco, {"by_seed": {}, "trials": []}).split("Ours")[0]
    )
