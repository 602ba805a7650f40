"""The command of runs/ting_synthetic runs, goes on where it was stopped, and writes its tables."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from harness import BEGIN, END

from mcpilco.identification import Solution

RUN = Path(__file__).parents[2] / "runs" / "ting_synthetic" / "run.py"


@pytest.fixture
def run(monkeypatch, tmp_path):
    """The command, with two cells and two fast methods."""
    spec = importlib.util.spec_from_file_location("ting_synthetic_run", RUN)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)  # dataclasses look their module up
    spec.loader.exec_module(module)
    fast = dict.fromkeys(module.METHODS, module.METHODS["OLS"])
    fast["VB b_true"] = lambda X, y, seed: Solution(np.append(module.B, np.zeros(90)))
    monkeypatch.setattr(module, "METHODS", fast)
    monkeypatch.setattr(module, "CELLS", dict(list(module.CELLS.items())[3:5]))
    monkeypatch.chdir(tmp_path)
    return module


def called(run, monkeypatch, *arguments: str) -> str:
    """The page that the command wrote."""
    monkeypatch.setattr(sys, "argv", ["run.py", *arguments, "--out", "out"])
    assert run.main() == 0
    page = Path("out/README.md").read_text(encoding="utf-8")
    return page.split(BEGIN)[1].split(END)[0]


@pytest.mark.slow
def test_the_true_coefficients_have_no_error_on_the_clean_test(run, monkeypatch):
    page = called(run, monkeypatch, "--quick")
    found = json.loads(Path("out/results/snr5-redundant90/0000.json").read_text())
    assert found["clean"]["VB b_true"] < 1e-20
    assert found["noisy"]["VB b_true"] > 0.1
    assert found["clean"]["OLS"] > 0.01
    assert "| SNR 2, 0 redundant, 90 irrelevant | OLS | 0.00 | 1 of 1 | 0.00 |" in page
    assert "Not measured yet" not in page
    assert Path("out/figure2.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_what_was_measured_is_not_measured_again(run, monkeypatch):
    called(run, monkeypatch, "--quick")
    path = Path("out/results/snr2-redundant0/0000.json")
    found = json.loads(path.read_text())
    found["clean"]["OLS"] = 7.0
    path.write_text(json.dumps(found))
    page = called(run, monkeypatch, "--quick")
    assert "7.0000 (7.000, 7.000 to 7.000)" in page


def test_equal_seeds_give_equal_errors(run):
    first, again = (run.trial(2.0, 60, 3, 150) for _ in range(2))
    other = run.trial(2.0, 60, 4, 150)
    assert first["clean"] == again["clean"] != other["clean"]
