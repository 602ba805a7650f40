"""The command of runs/ting_robots runs, goes on where it was stopped, and writes its tables."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from harness import BEGIN, END


@pytest.mark.slow
def test_the_command_writes_its_tables_and_measures_nothing_twice(run, monkeypatch, tmp_path):
    cell = "vision_head-0.0002"
    monkeypatch.setattr(run, "CELLS", {cell: run.CELLS[cell]})
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["run.py", "--quick", "--out", "out"])
    assert run.main() == 0
    path = Path("out") / "results" / cell / "0000.json"
    found = json.loads(path.read_text())
    ours = found["rows"][run.DEFAULT[0]][run.DEFAULT[1]]
    assert ours["consistent"] == ours["links"] == 7
    assert ours["position"] < found["rows"][run.BASELINE[0]][run.BASELINE[1]]["position"]
    found["rows"][run.DEFAULT[0]][run.DEFAULT[1]]["position"] = 7.0
    path.write_text(json.dumps(found))
    assert run.main() == 0
    page = Path("out/README.md").read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
    assert "Not measured yet" not in page
    assert f"| {run.DEFAULT[1]} | 7 (7 to 7) |" in page
