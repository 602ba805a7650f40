"""Laws of `mcpilco kinematics`: it tells the chain, writes plain files, and explains bad data."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from envs.arms.marked import Camera
from mcpilco.cli import main
from mcpilco.identification.kinematics import ForwardKinematics
from tests.mcpilco.identification.kinematics.robots import recorded
from tests.mcpilco.recordings.test_markers import write

CAMERA = Camera(0.002, 0.005, outliers=0.02, missing=0.02)


def test_chain_and_model_are_told_and_written(tmp_path: Path, capsys) -> None:
    arm, recording = recorded(5, joints=3, samples=80, camera=CAMERA)
    path = write(tmp_path / "arm.csv", recording.columns())
    out = tmp_path / "found"
    assert main(["kinematics", str(path), "--out", str(out), "--samples", "60"]) == 0
    told = json.loads((out / "kinematics.json").read_text())
    assert told["base"] == arm.markers[0]
    assert [joint["name"] for joint in told["joints"]] == list(arm.joints)
    assert [joint["kind"] for joint in told["joints"]] == list(arm.kinds)
    assert told["forward"]["errors"]["position_median_m"][0] < 0.02
    assert ForwardKinematics.load(out / "forward.npz").marker == arm.markers[-1]
    printed = capsys.readouterr().out
    assert f"base  marker {arm.markers[0]}" in printed
    assert (out / "kinematics.png").stat().st_size > 10_000


def test_no_file_lands_outside_of_the_folder(tmp_path: Path, capsys) -> None:
    _, recording = recorded(5, joints=2, samples=40)
    path, out = write(tmp_path / "arm.csv", recording.columns()), tmp_path / "found"
    out.mkdir()
    (out / "kinematics.json").symlink_to(tmp_path / "secret")
    assert main(["kinematics", str(path), "--out", str(out), "--samples", "20"]) == 2
    assert "outside of the folder" in capsys.readouterr().err
    assert not (tmp_path / "secret").exists()


def test_a_constant_joint_is_refused_with_exit_code_2(tmp_path: Path, capsys) -> None:
    _, recording = recorded(5, joints=3, samples=20)
    columns = {**recording.columns(), "q2": np.full(20, 0.5)}
    assert main(["kinematics", str(write(tmp_path / "arm.csv", columns))]) == 2
    assert "joint q2 is 0.5 throughout" in capsys.readouterr().err


@pytest.mark.parametrize("files", [[], ["a.csv", "b.csv", "c.csv"]])
def test_one_file_or_two_are_expected(files: list[str], capsys) -> None:
    assert main(["kinematics", *files]) == 2
    assert "expected one file, or one of poses" in capsys.readouterr().err
