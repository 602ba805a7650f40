from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent
RUN = ROOT / "runs" / "pathwise" / "run.py"


@pytest.fixture(scope="module")
def run():
    spec = importlib.util.spec_from_file_location("pathwise_run", RUN)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def spread(value):
    return {"mean": value, "std": 0.1, "median": value, "q1": value - 0.1, "q3": value + 0.1}


def make_summary(by_seed):
    """What seeds with these shares of success, trial by trial, give."""
    trials = [
        {
            "experience_s": 3.0 * k,
            "success": {"rate": p, "low": p / 2, "high": 1.0},
            "p": {"mean": p, "low": p / 2, "high": 1.0},
            "predicted_cost": spread(7.5),
            "real_cost": spread(8.5),
        }
        for k, p in enumerate(next(iter(by_seed.values())), start=1)
    ]
    return {
        "seeds": [int(seed) for seed in by_seed],
        "failed": {"7": "it was killed"},
        "trials": trials,
        "run": {key: spread(30.0) for key in ("starts", "policy_steps", "cpu_s", "wall_s")},
        "by_seed": {seed: {"p": p} for seed, p in by_seed.items()},
        "machines": [{"cpu": "Zen", "cores": 2, "versions": {"python": "3.11"}}],
    }


@pytest.fixture
def write(run, tmp_path):
    """Write README.md from summaries, and return it."""

    def write(**summaries):
        for name, summary in summaries.items():
            path = tmp_path / "results" / name / "summary.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(summary))
        run.write_readme(tmp_path)
        return (tmp_path / "README.md").read_text()

    return write


def test_quick_runs_a_seed_of_each_and_goes_on(tmp_path):
    def quick():
        return subprocess.run(
            [sys.executable, RUN, "--quick", "--workers", "1", "--out", tmp_path],
            capture_output=True,
            text=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )

    done = quick()
    assert done.returncode == 0, done.stdout + done.stderr
    text = (tmp_path / "README.md").read_text()
    assert "| `step`, one rollout, 1 seeds | 0.0 (0–79) |  |  |  |" in text
    assert "| `path`, p, 1 seeds | 0.0 |  |  |  |" in text
    settings = json.loads((tmp_path / "results" / "path" / "sweep.json").read_text())
    assert settings["config"]["model"]["sampling"] == "path"
    assert "1 of 1 seeds are there already" in quick().stdout
    assert (tmp_path / "README.md").read_text() == text


def test_the_settings_differ_in_what_is_compared_only(run):
    names = {"kernel", "degree", "integration", "optimiser", "noise_floor", "plausible"}
    step, path = run.SETTINGS["step"], run.SETTINGS["path"]
    assert (step.model.sampling, path.model.sampling) == ("step", "path")
    assert all(getattr(step.model, name) == getattr(path.model, name) for name in names)
    assert (step.policy, step.search) == (path.policy, path.search)
    assert run.SETTINGS["step-eager"].model == step.model


def test_tables_hold_every_trial_and_the_difference_seed_by_seed(write):
    text = write(
        step=make_summary({"0": [0.0, 0.5], "1": [0.25, 0.5], "5": [1.0, 1.0]}),
        path=make_summary({"0": [0.25, 0.5], "1": [0.5, 0.5], "2": [0.0, 0.0]}),
    )
    assert "| `step`, one rollout, 3 seeds | 0.0 (0–100) | 50.0 (25–100) |  |  |" in text
    assert "| `path`, real, 3 seeds | 8.50 (8.40–8.60) |" in text
    assert "the 2 seeds that both have [%], after 3 s, 6 s: 25.0 (25–25); 0.0 (0–0)." in text
    assert "| `path` | eager | 2 | 30.0 (29.9–30.1) |" in text
    assert "Zen, 2 cores; python 3.11" in text
    assert "- `step`, seed 7 broke off: it was killed" in text


def test_one_setting_alone_makes_no_difference(write):
    text = write(path=make_summary({"0": [0.25]}))
    assert "The difference of p needs results of step and of path." in text


def test_only_what_is_between_the_markers_is_rewritten(run, tmp_path, write):
    before = f"# Mine\n\n{run.BEGIN}\nold\n{run.END}\n\n## Differs\n\nMy words.\n"
    (tmp_path / "README.md").write_text(before)
    text = write()
    assert (
        text
        == f"# Mine\n\n{run.BEGIN}\n\nNot measured yet.\n\n{run.END}\n\n## Differs\n\nMy words.\n"
    )


def test_missing_markers_are_refused(tmp_path, write):
    (tmp_path / "README.md").write_text("# Mine\n")
    with pytest.raises(SystemExit, match="must hold the lines"):
        write()
