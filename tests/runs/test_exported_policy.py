from __future__ import annotations

import json
import shutil
import sys

import pytest

pytest.importorskip("jinja2")
pytest.importorskip("onnxruntime")


@pytest.mark.slow  # trains and compiles
@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
def test_quick_run_measures_c_numpy_and_onnx(run, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["run.py", "--quick", "--out", str(tmp_path)])
    run.main()
    [row] = json.loads((tmp_path / "results.json").read_text())["results"]
    assert 0 < row["double"]["us"] < row["numpy_us"]
    assert row["onnx_us"] > 0
    assert row["double"]["difference"] < 1e-6 < 1e-3 > row["float"]["difference"]
    assert "| states |" in (tmp_path / "README.md").read_text()
