"""The command of runs/kinematics runs, goes on where it was stopped, and writes its tables."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from harness import BEGIN, END
from kinematics.paths import random_way_points, through

RUN = Path(__file__).parents[2] / "runs" / "kinematics" / "run.py"


@pytest.fixture
def run(monkeypatch, tmp_path):
    spec = importlib.util.spec_from_file_location("kinematics_run", RUN)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)  # dataclasses look their module up
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "FORWARD", {"100-small": (100, 0.5)})
    monkeypatch.setattr(module, "LITERAL_STEPS", 5)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["run.py", "--quick", "--out", "out"])
    return module


@pytest.mark.slow
def test_tables_hold_what_was_measured_and_nothing_is_measured_twice(run) -> None:
    assert run.main() == 0
    path = Path("out/results/noise/0001.json")
    found = json.loads(path.read_text())
    assert found["chain"] is True
    path.write_text(json.dumps({**found, "chain": False}))
    assert run.main() == 0
    page = Path("out/README.md").read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
    assert "| noise-free | 150 |" in page
    assert "1 of 2" in page
    assert "mended, refit 3" in page
    assert "Not measured yet" not in page


def test_equal_robots_give_equal_counts_and_every_triplet_is_counted(run) -> None:
    first, again = (run.structure("noise", 3) for _ in range(2))
    assert first == again
    assert all(sum(cells) == 75 for cells in first["counts"].values())
    assert first["counts"]["P1"][1:3] == [0, 0]


def test_paths_reach_their_way_points_within_the_ranges() -> None:
    rng = np.random.default_rng(6)
    points = random_way_points(5, ("hinge", "slide"), rng)
    assert (np.abs(points) <= (2.0, 0.3)).all()
    order = rng.permutation(5)
    path = through(points, order, 10)
    assert len(path) == 41
    np.testing.assert_array_equal(path[::10], points[order])
