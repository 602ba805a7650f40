"""`mcpilco train --algo sac|tqc|ppo`, and what the other commands make of such a run."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from baselines.sb3 import PPOAgent, SACAgent, TQCAgent
from mcpilco.cli import main
from mcpilco.files import read_arrays
from mcpilco.logbook import Progress
from mcpilco.show.recorder import Recorder
from tests.baselines.sb3.small import TINY

KINDS = {"sac": SACAgent, "tqc": TQCAgent, "ppo": PPOAgent}


@pytest.fixture(autouse=True)
def tiny_presets(monkeypatch: pytest.MonkeyPatch, unchecked_shapes: None) -> None:
    for name, kind in KINDS.items():
        preset = dataclasses.replace(kind.presets["default"], config=TINY[name], by_env={})
        monkeypatch.setitem(kind.presets, "default", preset)


def train(folder: Path, *more: str, algo: str = "sac") -> int:
    return main(["train", "--algo", algo, "--quiet", "--out", str(folder), *more])


def files(folder: Path) -> dict[str, bytes]:
    """Contents of all that tells no time."""
    timed = ("metrics.csv", "summary.json", "result.json", "policy_steps.jsonl")
    paths = [path for path in sorted(folder.rglob("*")) if path.suffix in (".npz", ".json")]
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in paths
        if path.name not in (*timed, "config.json")
    }


@pytest.mark.parametrize("algo", sorted(KINDS))
def test_a_run_has_a_row_for_each_checkpoint_and_is_judged(algo, tmp_path, capsys):
    assert train(tmp_path / "run", algo=algo) == 0
    rows = (tmp_path / "run" / "metrics.csv").read_text().splitlines()
    assert [row.split(",")[:3] for row in rows[1:]] == [["1", "1.2", ""], ["2", "2.4", ""]]
    capsys.readouterr()
    assert main(["evaluate", str(tmp_path / "run"), "--episodes", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["trial"] == 2


class KilledError(Exception):
    pass


@pytest.mark.parametrize(
    "moment", ["practice", pytest.param("rollout", marks=pytest.mark.slow), "row"]
)
def test_a_killed_run_goes_on_and_ends_as_one_that_was_not(moment, tmp_path, monkeypatch):
    assert train(tmp_path / "whole", "--trials", "3") == 0

    def kill(self, *arguments):
        if 2 in arguments[:2] or getattr(arguments[0], "trial", None) == 2:
            raise KilledError
        return usual(self, *arguments)

    place, name = {
        "practice": (SACAgent, "_practise"),
        "rollout": (SACAgent, "_run_episode"),
        "row": (Recorder, "on_trial_end"),
    }[moment]
    usual = getattr(place, name)
    with monkeypatch.context() as patch:
        patch.setattr(place, name, kill)
        with pytest.raises(KilledError):
            train(tmp_path / "killed", "--trials", "3")
    assert main(["train", "--resume", str(tmp_path / "killed"), "--quiet"]) == 0
    assert files(tmp_path / "killed") == files(tmp_path / "whole")


def test_the_replay_buffer_is_kept_with_the_run(tmp_path):
    assert train(tmp_path / "run") == 0
    arrays = read_arrays(tmp_path / "run" / "agent.npz")
    assert len(arrays["memory/rewards"]) == 24
    assert np.isfinite(arrays["memory/observations"]).all()


@pytest.mark.slow
def test_a_run_is_reported_without_predictions(tmp_path):
    pytest.importorskip("matplotlib")
    assert train(tmp_path / "run") == 0
    assert main(["report", str(tmp_path / "run")]) == 0
    page = (tmp_path / "run" / "report.html").read_text()
    assert "cannot" not in page
    assert "Cost of each episode" in page
    assert "Calibration" not in page


@pytest.mark.slow
def test_a_sweep_judges_it_like_others(tmp_path):
    arguments = ["--seeds", "0:1", "--trials", "1", "--fresh", "2", "--workers", "1", "--quiet"]
    assert main(["sweep", "--algo", "ppo", "--out", str(tmp_path / "s"), *arguments]) == 0
    trial = json.loads((tmp_path / "s" / "sweep.json").read_text())
    assert trial["algo"] == "baselines:ppo"


def test_progress_speaks_of_no_models(tmp_path, capsys):
    SACAgent("MlpPolicy", "mcpilco/CartPoleSwingUp-v0").learn(12, callback=Progress())
    shown = capsys.readouterr().out
    assert "predicted cost -," in shown
    assert "nan" not in shown
    assert "model" not in shown


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--preset", "tip"], "--preset of the algorithm sac must be one of ['default']"),
        (["--exploration", "9"], "--exploration is no option of the algorithm sac"),
        (["--env", "mcpilco/CartPoleSwingUpPositions-v0"], "all states are measured"),
    ],
)
def test_what_it_cannot_do_is_said(arguments, sentence, tmp_path, capsys):
    assert train(tmp_path / "run", *arguments) == 2
    assert sentence in capsys.readouterr().err
