"""The command of runs/gip goes on where it was stopped, and writes its tables and pictures."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from harness import BEGIN, END

from envs.arms.robots import scara, ur10


@pytest.fixture
def called(run, monkeypatch, tmp_path):
    """The page that the command wrote, with its smallest sizes."""
    monkeypatch.chdir(tmp_path)
    experiments = sys.modules["gip.experiments"]
    small = experiments.Sizes(120, (110, 120), ("fe", "pp", "gip", "rbf"), 60)
    monkeypatch.setattr(run, "QUICK", small)
    monkeypatch.setattr(experiments, "PLAN_S", 0.05)
    monkeypatch.setattr(experiments, "EFFICIENT", ("pp", "gip", "rbf"))

    def call(*only: str) -> str:
        monkeypatch.setattr(sys, "argv", ["run.py", "--quick", "--out", "out", "--only", *only])
        assert run.main() == 0
        return Path("out/README.md").read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]

    return call


@pytest.mark.slow
def test_tables_and_pictures_are_written(called):
    page = called("scara", "efficiency")
    assert "Not measured yet" not in page
    for name in ("scara", "efficiency"):
        assert Path(f"out/{name}.png").stat().st_size > 1000
        assert f"({name}.png)" in page
    assert "| `gip` |" in page
    assert "UR10" not in page


def test_what_was_measured_is_not_measured_again(called, run):
    path = Path("out/results/scara/0000.json")
    found = {
        "seed": 0,
        "samples": 2000,
        "joints": ["a", "b", "c", "d"],
        "nmse": {"gip": [1e-4, 1e-4, 1e-4, 1e-2], "rbf": [1e-2] * 4, "pp": [0.5, 0.5, 0.5, 1e-3]},
        "cpu_s": {"gip": 1.0, "rbf": 1.0, "pp": 1.0},
        "forward": {"gip": {"positive": 0.5, "nmse": [0.1] * 4}},
        "tracking": {"pd": [0.1] * 4},
        "machine": {"cpu": "z80", "cores": 1},
    }
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(found))
    page = called("scara")
    assert "5e-2 on joint 4: yes" in page
    assert "`gip` and `rbf`: 0.01, 0.01, 0.01, 1; below 0.2 on joints 1, 2, 4: **no**" in page
    assert "`gip` and `pp`: 0.0002, 0.0002, 0.0002, 10; below 1 on all joints: **no**" in page


def test_equal_seeds_give_equal_data(run):
    experiments = sys.modules["gip.experiments"]
    first, again, other = (
        experiments.measured(experiments.scara(), np.random.default_rng(seed), 20)
        for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first.tau, again.tau)
    assert (first.tau != other.tau).all()


@pytest.mark.parametrize("arm", [scara(), ur10()], ids=["scara", "ur10"])
def test_errors_of_a_robot_stay_within_their_bounds(run, arm):
    experiments = sys.modules["gip.experiments"]
    robot = experiments.perturbed(arm, np.random.default_rng(2))
    for body, other in zip(arm.bodies, robot.bodies, strict=True):
        shift = np.subtract(other.origin, body.origin)
        turn = np.array(body.rotation).T @ np.array(other.rotation)
        angle = np.arccos((np.trace(turn) - 1.0) / 2.0)
        assert 0.0 < np.abs(shift).max() <= experiments.LENGTH
        assert 0.0 < angle <= np.sqrt(2.0) * experiments.ANGLE
        assert (other.mass, other.inertia) == (body.mass, body.inertia)


def test_equal_seeds_give_equal_robots(run):
    experiments, arm = sys.modules["gip.experiments"], scara()
    first, again, other = (
        experiments.perturbed(arm, np.random.default_rng(seed)) for seed in (3, 3, 4)
    )
    assert first == again != other
