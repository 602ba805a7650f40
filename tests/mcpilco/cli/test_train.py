from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mcpilco.agent.agent
import mcpilco.show
from mcpilco.agent import MCPILCO, agent_of, begin_run, learn_rest
from mcpilco.agent.numpy_policy import NumpyPolicy
from mcpilco.cli import main
from mcpilco.cli.view import View
from mcpilco.config import CART_POLE, PRESETS, REGULATOR_ROOM
from mcpilco.logbook import RunFolder
from mcpilco.show import run_callbacks
from tests.mcpilco.fakes import FakeAgent
from tests.mcpilco.point import TINY

PNG = b"\x89PNG\r\n"


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The agent that learns nothing, in an empty folder, without a display."""
    monkeypatch.setattr(mcpilco.agent.agent, "MCPILCO", FakeAgent)
    monkeypatch.setattr(mcpilco.show, "has_display", lambda: False, raising=False)
    monkeypatch.chdir(tmp_path)


def told(capsys: pytest.CaptureFixture[str], name: str) -> Path:
    """The path that a line of what was printed names."""
    lines = capsys.readouterr().out.splitlines()
    return Path(next(line for line in lines if line.startswith(name)).split()[-1])


def test_a_warm_start_begins_with_policy_and_numbers_of_a_run(tmp_path: Path, capsys) -> None:
    source, more = tmp_path / "source", tmp_path / "more"
    agent = MCPILCO("SumOfGaussians", CART_POLE, config=TINY)
    run = begin_run(source, agent, "mcpilco", CART_POLE, {}, "thesis", 1)
    with run_callbacks(run, progress=False) as callbacks:
        learn_rest(run, agent, callbacks)
    command = ["train", "--warm-start", str(source), "--out", str(more), "--quiet"]
    assert main([*command, "--trials", "1"]) == 0
    run = RunFolder.open(more)
    assert run.config["config"] == RunFolder.open(source).config["config"]
    assert run.config["preset"] == "thesis"
    learned = MCPILCO.load(more / "agent.npz", CART_POLE)
    assert learned.taught
    assert main([*command, "--memory", "1", "--horizon", "5"]) == 2
    assert "leave out --horizon, --memory" in capsys.readouterr().err


MODEL = """
<mujoco model="swing">
  <worldbody>
    <body>
      <joint name="cart" type="slide" axis="1 0 0"/><geom size="0.1" mass="1"/>
      <body><joint name="hinge" axis="0 1 0"/><geom pos="0 0 -0.5" size="0.1" mass="1"/></body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="cart" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


@pytest.mark.usefixtures("fake")
def test_a_model_file_is_learned_in_with_the_goal_of_a_task_file(tmp_path: Path, capsys) -> None:
    (tmp_path / "swing.xml").write_text(MODEL)
    (tmp_path / "goal.toml").write_text("dt = 0.1\ncost.hinge_position = { lengthscale = 0.5 }\n")
    command = ["train", "--sim", "swing.xml", "--trials", "1", "--horizon", "5", "--out", "run"]
    assert main([*command, "--task", "goal.toml"]) == 0
    config = RunFolder.open(tmp_path / "run").config
    assert config["env"] == "mcpilco/Model-v0"
    assert config["env_kwargs"] == {
        "max_episode_steps": 5,
        "model": str(tmp_path / "swing.xml"),
        "dt": 0.1,
        "cost": {"hinge_position": {"lengthscale": 0.5}},
    }
    assert main(command) == 2
    assert "--sim needs --task FILE" in capsys.readouterr().err
    assert main([*command, "--task", "goal.toml", "--env", "other/Env-v0"]) == 2
    assert "--sim takes the place of --env" in capsys.readouterr().err


@pytest.mark.usefixtures("fake")
def test_the_demo_needs_no_argument_and_leaves_a_picture_of_two_trials(capsys) -> None:
    pytest.importorskip("matplotlib")
    assert main(["demo"]) == 0
    picture = told(capsys, "Picture:")
    assert picture.read_bytes().startswith(PNG)
    assert RunFolder.open(picture.parent).finished_trials() == [1, 2]


@pytest.mark.usefixtures("fake")
def test_without_matplotlib_the_demo_says_so_and_leaves_the_recording(capsys, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    assert main(["demo", "--out", "here"]) == 0
    out, err = capsys.readouterr()
    assert "Recording:  here/rollouts/02.rrd" in out.splitlines()
    assert Path("here/rollouts/02.rrd").stat().st_size > 0
    assert "without the picture: Plots need matplotlib" in err


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize(("flags", "shown"), [((), [Path("here")]), (("--no-view",), [])])
def test_the_demo_opens_the_viewer_where_there_is_a_display(monkeypatch, flags, shown) -> None:
    seen = []
    monkeypatch.setattr(mcpilco.show, "has_display", lambda: True, raising=False)
    monkeypatch.setattr(View, "__call__", lambda view: seen.append(view.run) or 0)
    assert main(["demo", "--out", "here", *flags]) == 0
    assert seen == shown


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked_shapes")
def test_the_second_policy_of_the_demo_swings_the_pole_up(tmp_path: Path) -> None:
    assert main(["demo", "--no-view", "--out", str(tmp_path / "run")]) == 0
    assert RunFolder.open(tmp_path / "run").metrics()[-1]["success"]


@pytest.mark.slow
def test_a_regulator_is_trained_evaluated_reported_and_exported(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    preset = replace(PRESETS["default"], config=TINY)
    monkeypatch.setitem(PRESETS, "default", preset)
    run, policy = tmp_path / "run", tmp_path / "policy.npz"
    asked = ["--regulator", "--model", "physics+rbf", "--preset", "default", "--horizon", "9"]
    assert main(["train", *asked, "--trials", "1", "--out", str(run), "--quiet"]) == 0
    assert RunFolder.open(run).config["config"]["policy"]["regulator"] == REGULATOR_ROOM
    agent = agent_of(RunFolder.open(run), 1)
    assert agent.policy.regulator.acts
    assert main(["evaluate", str(run), "--episodes", "2"]) == 0
    assert main(["report", str(run)]) == 0
    assert main(["export", str(run), str(policy), "--c", str(tmp_path / "policy.h")]) == 0
    near = np.array([0.0, 0.0, 3.1, 0.0])
    np.testing.assert_allclose(NumpyPolicy(policy)(near), agent.predict(near)[0], atol=1e-6)
    assert "_regulator(x, u)" in (tmp_path / "policy.h").read_text()
    capsys.readouterr()
    assert main(["train", "--regulator", "--algo", "pilco", "--out", str(tmp_path / "no")]) == 2
    assert "--regulator is an option of the algorithm mcpilco" in capsys.readouterr().err
