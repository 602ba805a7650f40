from __future__ import annotations

import importlib
import json
import os
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

ROOT = Path(__file__).parent.parent.parent
COMMAND = ROOT / "runs" / "speed_policy_step.py"
LOOPS = (
    *("forward", "backward", "outside", "augment", "centres", "exponentials", "drop", "activate"),
    *("pulling", "act", "shift", "expand", "lower", "upper", "prior", "sample", "weigh"),
    *("collect", "differentiate"),
)


@pytest.fixture
def modules(monkeypatch):
    """What the command imports, beside itself."""
    monkeypatch.syspath_prepend(str(COMMAND.parent))
    from speed import parts, step, survey

    yield {"parts": parts, "step": step, "survey": survey}
    for name in [name for name in sys.modules if name.partition(".")[0] == "speed"]:
        del sys.modules[name]


def call(*words):
    return subprocess.run(
        [sys.executable, COMMAND, *map(str, words)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def numbers(value):
    """All of a JSON value."""
    if isinstance(value, dict | list):
        inner = value.values() if isinstance(value, dict) else value
        return [number for part in inner for number in numbers(part)]
    return [value] if isinstance(value, int | float) else []


@pytest.mark.slow
def test_quick_survey_writes_its_page_from_finite_numbers(tmp_path):
    flags = "--all", "--quick", "--repeats", "2", "--out", tmp_path
    done = call(*flags)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads((tmp_path / "results.json").read_text())
    assert np.isfinite(numbers(found)).all()
    assert all(row["ours_s"] > 0 for row in found["ratios"])
    text = (tmp_path / "README.md").read_text()
    assert "| 4, 3, 5, 8 | `fused` |" in text
    assert "### Memory, P, T, B, N = 4, 3, 5, 8" in text
    assert "One thread." in text


def test_the_plain_step_samples_its_posterior_and_follows_the_gradient(modules):
    """Where it has data a draw is what was measured, and the cost of a rollout falls."""
    torch.manual_seed(0)
    plain = importlib.import_module("speed.plain")
    gps, policy, _ = plain.make(60, bases=50)
    targets = torch.stack([gp.kernel(gp.X, gp.X) @ gp.alpha for gp in gps], -1)
    draws = torch.stack([gp.sample(gp.X) for gp in gps], -1)
    assert (draws - targets).abs().max() < 5.0 * plain.NOISE
    optimiser = torch.optim.Adam(policy.parameters(), 0.05)
    costs = [plain.policy_step(gps, policy, optimiser, 50, 10) for _ in range(30)]
    assert np.mean(costs[-5:]) < np.mean(costs[:5])


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["--all", "--quick"], "pass --out"),
        (["--yardstick", "missing.py"], "must be a Python file, got missing.py"),
        (["--measure", "parts", "--engine", "eager"], "--engine eager has none"),
    ],
)
def test_command_says_what_is_missing(modules, monkeypatch, words, remedy):
    monkeypatch.setattr(sys, "argv", ["speed_policy_step.py", *words])
    with pytest.raises(SystemExit, match=remedy):
        runpy.run_path(str(COMMAND), run_name="__main__")


def test_parts_add_up_to_the_step(modules):
    loops = dict(zip(LOOPS, np.random.default_rng(0).uniform(size=len(LOOPS)), strict=True))
    total = sum(modules["parts"].parts(loops).values())
    assert total == pytest.approx(loops["forward"] + loops["backward"] + loops["outside"])


def test_every_loop_of_the_parts_is_one_that_is_timed(modules):
    assert {*modules["parts"].SWEEPS, "forward", "backward", "outside"} == set(LOOPS)


@pytest.mark.slow
def test_shares_of_a_real_step_are_finite(modules):
    found = modules["parts"].shares(modules["step"].Size(20, 12, 3, 9), "fused", repeats=2)
    assert np.isfinite(numbers(found)).all()
    assert found["triangular_gflops"] > 0
    assert found["peak_gflops"] > 0


def test_tables_hold_calls_parts_and_targets(modules):
    survey = modules["survey"]
    size = {"particles": 400, "samples": 60, "steps": 60, "bases": 200, "engine": "float32"}
    spent = {"wall_s": 9.5, "cpu_s": 9.25}
    part = {"parts_ms": {"dropout": 1.0, "rest": 3.0}, "triangular_gflops": 90, "peak_gflops": 120}
    assert survey.target_of(size) == 10.0
    assert survey.target_of({**size, "engine": "eager"}) is None
    calls = survey.call_table({"calls": [{"engine": "fused", "first": spent, "later": spent}]})
    assert "| `fused` | 9.50 | 9.25 | 9.50 | 9.25 |" in calls
    found = {"parts": [{**size, **part}]}
    assert "| dropout | 1.0 (25 %) |" in survey.part_table(found)
    assert "| float32, N = 60 |" in survey.rate_table(found)
    assert "| share [%] | 75 |" in survey.rate_table(found)
