"""`mcpilco inverse-dynamics`: what it prints and writes, and what it refuses."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mcpilco.bodies import generalised_forces
from mcpilco.cli import main
from mcpilco.identification.inverse_dynamics import load_inverse_dynamics
from mcpilco.mjcf import chain_of

MODEL = """<mujoco><worldbody><body name="arm"><joint name="turn" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.05" mass="2"/>
<body name="rod" pos="0.4 0 0"><joint name="push" type="slide" axis="1 0 0"/>
<geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.03" mass="1"/></body></body>
</worldbody></mujoco>"""
JOINTS = ("turn", "push")
ROOT = Path(__file__).parents[3]


def write(path, seed: int = 0, rows: int = 300, still: bool = False) -> str:
    """A log of the robot, with all columns."""
    chain = chain_of(mujoco.MjModel.from_xml_string(MODEL))
    rng = np.random.default_rng(seed)
    t = 0.02 * np.arange(rows)
    w, phase = rng.uniform(0.5, 3.0, (2, 8)), rng.uniform(0, 6.0, (2, 8))
    size = np.array([0.5, 0.0 if still else 0.05])
    arg = t[:, None, None] * w + phase
    q = size * np.sin(arg).sum(-1)
    dq, ddq = size * (w * np.cos(arg)).sum(-1), -size * (w**2 * np.sin(arg)).sum(-1)
    tau = generalised_forces(chain, q, dq, ddq) + 1e-3 * rng.normal(size=q.shape)
    logged = ("position", "velocity", "acceleration", "torque")
    header = ",".join(["time", *(f"{joint}_{what}" for what in logged for joint in JOINTS)])
    np.savetxt(
        path, np.column_stack([t, q, dq, ddq, tau]), delimiter=",", header=header, comments=""
    )
    return str(path)


@pytest.fixture
def run(tmp_path, monkeypatch, unchecked_shapes):
    """The command's exit code, in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: main(["inverse-dynamics", *arguments, "--out", "out"])


def test_a_model_is_learned_tested_and_saved(run, tmp_path, capsys):
    files = write(tmp_path / "a.csv", 0), write(tmp_path / "b.csv", 1)
    assert run(*files, "--joints", "RP", "--samples", "200") == 0
    told = capsys.readouterr().out
    assert "200 samples to learn from, 120 to test on." in told
    errors = dict(re.findall(r"(\w+): nMSE (\S+),", told))
    assert float(errors["turn"]) < 1e-2
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert list(report["nmse"]) == ["turn", "push"]
    assert f"{report['nmse']['push']:.2e}" == errors["push"]
    assert (tmp_path / "out" / "torques.png").stat().st_size > 1000
    assert load_inverse_dynamics(tmp_path / "out" / "model.npz").joints == JOINTS


def test_a_geometry_comes_from_a_model(run, tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(MODEL)
    log = write(tmp_path / "a.csv")
    assert run(log, "--model", "arm.xml", "--kernel", "fe", "--frictionless") == 0
    assert load_inverse_dynamics(tmp_path / "out" / "model.npz").fitted.kernel == "fe"
    errors = re.findall(r"nMSE (\S+),", capsys.readouterr().out)
    assert max(map(float, errors)) < 1e-3


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "give --joints, as in --joints HHSH, or the robot's --model"),
        (("--joints", "RPR"), "says 3 joints, .*a.csv has 2: turn, push"),
        (("--joints", "RQ"), "a letter for each joint"),
        (("--joints", "RP", "--kernel", "pp"), "needs the robot's geometry"),
        (("--model", "none.xml"), "--model must be an MJCF file"),
        (("--joints", "RP", "--hold-out", "1"), "held-out share must be between 0 and 1"),
    ],
)
def test_a_wrong_argument_is_told(run, tmp_path, capsys, arguments, sentence):
    assert run(write(tmp_path / "a.csv"), *arguments) == 2
    assert re.search(sentence, capsys.readouterr().err)


def test_data_that_cannot_tell_are_refused_with_what_to_record(run, tmp_path, capsys):
    assert run(write(tmp_path / "a.csv", still=True), "--joints", "RP") == 2
    assert "record motions that move every joint" in capsys.readouterr().err
    assert run(write(tmp_path / "b.csv", rows=30), "--joints", "RP") == 2
    assert "need at least 50 samples, got 30; record for longer" in capsys.readouterr().err
    log = write(tmp_path / "c.csv")
    assert run(log, log, "--joints", "RP") == 2
    assert "give each file once" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_page_is_followed_word_by_word(tmp_path, monkeypatch, unchecked_shapes):
    """Its first block records, its command learns."""
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "inverse-dynamics.md").read_text(encoding="utf-8")
    exec(re.search(r"^```python\n(.*?)^```$", page, re.M | re.S)[1], {})
    (command,) = re.findall(r"^    mcpilco (inverse-dynamics .*)$", page, re.M)
    assert main(shlex.split(command)) == 0
    report = json.loads(Path("model/report.json").read_text())
    assert max(report["nmse"].values()) < 0.01
