from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from harness import BEGIN, END

ROOT = Path(__file__).parent.parent.parent


def spread(value):
    return {"mean": value, "std": 0.1, "median": value, "q1": value - 0.1, "q3": value + 0.1}


def make_summary(shares, seeds=30):
    """What 30 seeds of 4 trials give, the shares of success being as told."""
    trials = [
        {
            "experience_s": 3.0 * k,
            "success": {"rate": share, "low": share / 2, "high": 1.0},
            "p": {"mean": share, "low": share / 2, "high": 1.0},
            **{key: spread(share) for key in ("time_up_s", "mean_abs_cart_m")},
        }
        for k, share in enumerate(shares, start=1)
    ]
    found = {"success": [False, True], "p": [0.25, 0.75], "return": [3.0, 9.0], "cpu_s": 31.0}
    lost = {**found, "success": [True, False]}
    return {
        "seeds": list(range(seeds)),
        "failed": {"7": "it was killed"},
        "trials": trials,
        "solved": {"rate": 1.0, "low": 0.9, "high": 1.0},
        "run": {key: spread(30.0) for key in ("starts", "policy_steps", "cpu_s", "wall_s")},
        "by_seed": {"0": found, "1": lost},
        "machines": [{"cpu": "Zen", "cores": 2, "versions": {"python": "3.11"}}],
    }


@pytest.fixture
def write(run, tmp_path):
    """Write README.md from summaries, and return it."""

    def write(**summaries):
        for preset, summary in summaries.items():
            path = tmp_path / "results" / preset / "summary.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(summary))
        run.write_readmes(tmp_path)
        return (tmp_path / "README.md").read_text()

    return write


@pytest.mark.slow  # trains, if quickly
def test_quick_runs_two_seeds_and_shows_them_beside_the_thesis(tmp_path, home):
    command = [sys.executable, home / "run.py", "--quick", "--presets", "default"]
    done = subprocess.run(
        [*command, "--workers", "2", "--out", tmp_path],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    seeds = sorted((tmp_path / "results" / "default" / "seeds").iterdir())
    assert [path.name for path in seeds] == ["0000.json", "0001.json"]
    text = (tmp_path / "README.md").read_text()
    assert "| MC-PILCO, thesis | 3.8 | 38.5 | 69.2 | 88.5 |" in text
    told = "| `default`, one rollout a policy, 2 seeds | 0.0 (0–66) |  |  |  |"
    assert told in text


def test_tables_hold_every_trial_beside_the_published_figures(write):
    text = write(default=make_summary([0.1, 0.7, 0.9, 1.0]))
    assert "10.0 (5–100) | 70.0 (35–100) | 90.0 (45–100) | 100.0 (50–100)" in text
    assert "| PILCO, thesis | 0.51 | 0.52 | 0.32 | 0.19 |" in text
    assert "`default`, mean ± std | 0.10 ± 0.10 | 0.70 ± 0.10 |" in text
    assert "Zen, 2 cores; python 3.11" in text


@pytest.mark.parametrize(
    ("shares", "verdict"),
    [
        ([0.3, 0.85, 0.97, 0.99], "**holds** (30.0 %, 85.0 %, 97.0 %, 99.0 %, 30 seeds)"),
        ([0.9, 0.9, 0.96, 1.0], "**does not hold**"),
        ([0.9, 0.9, 0.9], "**not measured yet**"),
    ],
)
def test_verdict_follows_the_measured_rates(write, shares, verdict):
    assert verdict in write(default=make_summary(shares))


def test_seeds_that_failed_are_listed(write):
    text = write(thesis=make_summary([0.1, 0.7, 0.9, 1.0]))
    assert "- `thesis`, last test rollout: 1 (p 0.75)\n" in text
    assert "- `thesis`, seed 7 broke off: it was killed\n" in text


def test_later_setting_has_a_row_a_seed(write):
    text = write(tro2022=make_summary([0.5, 1.0], seeds=2))
    assert "| 0 | 2 | no yes | 0.25 0.75 | 31 |\n" in text
    assert "| 1 | 1 | yes no | 0.25 0.75 | 31 |\n" in text
    assert "Solved within 2 trials, that is, a test rollout succeeds: 2 of 2 seeds" in text


def test_only_what_is_between_the_markers_is_rewritten(run, tmp_path, write):
    before = f"# Mine\n\n{BEGIN}\nold\n{END}\n\n## Differs\n\nMy words.\n"
    (tmp_path / "README.md").write_text(before)
    first = write(default=make_summary([0.1]))
    assert first.startswith(f"# Mine\n\n{BEGIN}\n")
    assert first.endswith(f"{END}\n\n## Differs\n\nMy words.\n")
    assert "\nold\n" not in first
    assert write() == first


def test_claim_page_of_the_repository_has_its_markers(home):
    text = (home / "README.md").read_text()
    assert text.count(BEGIN) == text.count(END) == 1
