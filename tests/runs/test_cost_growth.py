from __future__ import annotations

import json
import sys

import numpy as np
import pytest

pytest.importorskip("matplotlib")


@pytest.mark.slow  # compiles what no other test needs
def test_quick_run_writes_its_table_and_plot_from_finite_times(run, tmp_path, monkeypatch):
    words = ["run.py", "--quick", "--repeats", "1", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    run.main()
    rows = json.loads((tmp_path / "results.json").read_text())["rows"]
    for row in rows.values():
        times = np.array([row[engine] for engine in run.ENGINES])
        assert times.shape == (len(run.ENGINES), len(row["sizes"]), 3)
        assert np.isfinite(times).all()
        assert (times > 0).all()
    text = (tmp_path / "README.md").read_text()
    assert "| training samples N | 5 | 10 | 20 |" in text
    assert "P = 4, k = 1, T = 3." in text
    assert "nan" not in text
    assert (tmp_path / "growth.png").read_bytes().startswith(b"\x89PNG")


def test_quick_run_does_not_overwrite_the_measured_table(run, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["run.py", "--quick"])
    with pytest.raises(SystemExit, match="pass --out"):
        run.main()


@pytest.mark.parametrize("power", [0.0, 1.0, 2.0])
def test_slope_of_a_power_law_is_its_exponent(run, power):
    sizes = [30, 60, 120, 240]
    assert run.slope(sizes, [7.0 * size**power for size in sizes]) == pytest.approx(power)


def test_slopes_tell_the_upper_half_from_all(run):
    sizes = [1, 2, 4, 8, 16]
    spreads = [[0.0, max(4.0, size), 0.0] for size in sizes]
    row = {"sizes": sizes, **dict.fromkeys(run.ENGINES, spreads)}
    cells = run.slopes({"particles": row}).splitlines()[-1].split(" | ")
    assert cells[1:3] == ["1–16", "4–16"]
    assert 0.0 < float(cells[3]) < 1.0
    assert float(cells[4]) == 1.0


@pytest.mark.slow  # compiles single precision, as no other test does
@pytest.mark.parametrize("joints", [1, 3])
def test_step_of_a_chain_is_finite_in_both_precisions(run, joints):
    size = run.Size(particles=6, samples=7, steps=4, joints=joints, bases=5)
    costs = {engine: run.make_step(size, engine)()[0] for engine in run.ENGINES}
    assert costs["float32"] == pytest.approx(costs["float64"], rel=1e-4)
