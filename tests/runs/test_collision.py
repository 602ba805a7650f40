"""The command of runs/collision runs, goes on where it was stopped, and writes its tables."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from harness import BEGIN, END

from envs.arms.sticky_arm import Push
from mcpilco.identification.collision import Detection

pytestmark = pytest.mark.xdist_group("collision run")  # one process makes it for all of them


@pytest.fixture(scope="module")
def written(run, tmp_path_factory) -> Path:
    """The folder that `--quick` wrote, with one controller."""
    out = tmp_path_factory.mktemp("collision") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "CONTROLLERS", {"pd": run.CONTROLLERS["pd"]})
        patch.setattr(sys, "argv", ["run.py", "--quick", "--out", str(out)])
        assert run.main() == 0
    return out


def page(out: Path) -> str:
    return (out / "README.md").read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]


@pytest.mark.slow
def test_its_tables_hold_each_model_and_each_detector(run, written):
    told = page(written)
    found = json.loads((written / "results/pd/0000.json").read_text())
    for kind in run.SHOWN:
        assert f"| {kind} | at rest | " in told
    for detector in run.DETECTORS:
        assert f"| {detector} | " in told
    pp = found["rmse"]["PP"]["resting"][0]
    assert f"| PP | at rest | {pp:.3f} ({pp:.3f} to {pp:.3f}) |" in told
    assert "2 pushes a cell." in told
    assert "Not measured yet" not in told
    for name in ("errors.png", "currents.png"):
        assert (written / name).stat().st_size > 5_000


@pytest.mark.slow
def test_compensated_friction_is_better_at_rest_even_on_few_data(written):
    found = json.loads((written / "results/pd/0000.json").read_text())["rmse"]
    assert (np.array(found["FC"]["resting"]) < 0.5 * np.array(found["PP"]["resting"])).all()


@pytest.mark.slow
def test_what_was_measured_is_not_measured_again(run, written, monkeypatch):
    path = written / "results/pd/0000.json"
    found = json.loads(path.read_text())
    found["rmse"]["PP"]["resting"][0] = 77.0
    path.write_text(json.dumps(found))
    monkeypatch.setattr(run, "CONTROLLERS", {"pd": run.CONTROLLERS["pd"]})
    monkeypatch.setattr(sys, "argv", ["run.py", "--quick", "--out", str(written)])
    monkeypatch.setattr(run, "trial", None)
    assert run.main() == 0
    assert "77.000 (77.000 to 77.000)" in page(written)


@pytest.mark.slow
def test_a_push_is_found_where_an_alarm_begins_while_it_acts(run):
    time = 0.008 * np.arange(500)
    alarm = np.zeros((500, 1), dtype=bool)
    alarm[60:70] = alarm[200:300] = True
    nothing = np.zeros((500, 1))
    found = Detection(time, nothing, nothing, nothing, alarm, alarm)
    push = Push(time[50], 1.0, duration_s=0.4)
    late = dataclasses.replace(push, start_s=time[220])  # the alarm was on before
    assert run.hits(found, (push, late)) == pytest.approx([0.08])
