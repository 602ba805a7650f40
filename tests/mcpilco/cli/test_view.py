"""`mcpilco view --video`; the rest of the command is tested with those of learning."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import mcpilco.agent
from mcpilco.cli import main
from mcpilco.config import PRESETS
from mcpilco.logbook import RunFolder
from tests.mcpilco.point import TINY

STEPS = 5


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unchecked_shapes: None) -> RunFolder:
    """Two trials of a small agent."""
    small = dataclasses.replace(PRESETS["default"], config=TINY)
    monkeypatch.setitem(PRESETS, "default", small)
    command = ["train", "--trials", "2", "--horizon", str(STEPS), "--quiet", "--out"]
    assert main([*command, str(tmp_path / "run")]) == 0
    return RunFolder.open(tmp_path / "run")


@pytest.mark.parametrize(("trial", "flags"), [(2, ()), (1, ("--trial", "1"))])
def test_a_video_shows_the_rollout_of_the_trial(
    run: RunFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, trial: int, flags: tuple
) -> None:
    rollouts, run_episode = [], mcpilco.agent.run_episode

    def watched(*arguments):
        rollouts.append(run_episode(*arguments))

    monkeypatch.setattr(mcpilco.agent, "run_episode", watched)
    video = tmp_path / "a.gif"
    assert main(["view", str(run.path), "--video", str(video), *flags]) == 0
    recorded = run.read_arrays(trial, "rollout")
    np.testing.assert_array_equal(rollouts[0].states, recorded["states"])
    with Image.open(video) as frames:
        assert frames.n_frames == STEPS + 1
        assert frames.info["duration"] == 1000 * recorded["dt"]


@pytest.mark.parametrize("flag", ["--web", "--live", "--screenshot=a.png"])
def test_a_video_is_not_shown_otherwise_too(run: RunFolder, capsys, flag: str) -> None:
    assert main(["view", str(run.path), "--video", "a.gif", flag]) == 2
    assert "--video takes one run, and no --live" in capsys.readouterr().err


def test_an_env_that_draws_nothing_is_named(run: RunFolder, capsys, monkeypatch) -> None:
    class Blind:
        render_mode = None
        close = staticmethod(lambda: None)

    monkeypatch.setattr(mcpilco.agent, "open_run_env", lambda run, kwargs: Blind())
    assert main(["view", str(run.path), "--video", "a.gif"]) == 2
    assert "mcpilco/CartPoleSwingUp-v0 draws no pictures" in capsys.readouterr().err
