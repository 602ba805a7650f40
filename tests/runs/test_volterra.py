"""The command of runs/volterra runs, goes on where it was stopped, and writes its tables."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from harness import BEGIN, END
from volterra.systems import MEMORY, third_order, third_order_h2, wiener


@pytest.fixture
def few(run, monkeypatch, tmp_path):
    """The command, with two small cells."""
    cells = {
        "third-order-2": run.ThirdOrder(1.0),
        "wiener-2-20dB": run.Wiener(2, 20.0, ("sed-mpk",), 5),
    }
    monkeypatch.setattr(run, "CELLS", cells)
    monkeypatch.setattr(run, "LAGS", 20)
    monkeypatch.setattr(run, "EARLY", 1e-3)
    monkeypatch.chdir(tmp_path)
    return run


def called(run, monkeypatch, *arguments: str) -> str:
    """The page that the command wrote."""
    cells = ["--cells", *run.CELLS]
    monkeypatch.setattr(sys, "argv", ["run.py", *cells, *arguments, "--out", "out"])
    assert run.main() == 0
    return Path("out/README.md").read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]


@pytest.mark.slow
def test_what_was_measured_stands_in_the_tables_and_is_not_measured_again(few, monkeypatch) -> None:
    page = called(few, monkeypatch, "--quick")
    path = Path("out/results/third-order-2/0000.json")
    found = json.loads(path.read_text())
    kernels = found["kernels"]
    assert f"| (6.36), setup 2 | PK | 1 | {kernels['pk']['fit']:.1f} (" in page
    assert "Not measured yet" not in page
    assert max(kernel["against_kernel"] for kernel in kernels.values()) < 1e-10
    assert {path.name for path in Path("out").glob("*.png")} == {"fits.png", "penalties.png"}

    kernels["pk"]["fit"] = 12.3
    path.write_text(json.dumps(found))
    page = called(few, monkeypatch, "--quick")
    assert "| (6.36), setup 2 | PK | 1 | 12.3 (12.3 to 12.3)" in page


def test_equal_seeds_give_equal_data_and_kernels_see_the_same(few) -> None:
    for cell, draw in zip(few.CELLS.values(), (few.draw_third_order, few.draw_wiener), strict=True):
        (first, u, truth), (again, _, _), (other, _, _) = (
            draw(cell, seed, 50) for seed in (3, 3, 4)
        )
        assert (first.inputs == again.inputs).all()
        assert not (first.inputs == other.inputs).any()
        assert len(u) == len(truth)


def test_the_noise_is_what_the_ratio_says(few) -> None:
    cell = few.CELLS["wiener-2-20dB"]
    noisy, _, _ = few.draw_wiener(cell, 0, 2000)
    quiet, _, _ = few.draw_wiener(few.Wiener(2, float("inf"), (), 1), 0, 2000)
    noise = (noisy.outputs - quiet.outputs).std()
    assert noise == pytest.approx(0.1 * quiet.outputs.std(), rel=0.05)
    assert few.noise_of(noisy, cell, 0, 2000) == pytest.approx(0.1 * quiet.outputs.std())


def test_the_quadratic_part_of_the_third_order_system_is_its_map() -> None:
    """What is even in the input is quadratic."""
    u = np.random.default_rng(10).normal(size=40)
    X = np.stack([u[MEMORY - t : len(u) - t] for t in range(MEMORY + 1)], 1)
    even = 0.5 * (third_order(u) + third_order(-u))
    np.testing.assert_allclose(even, np.einsum("ij,ni,nj->n", third_order_h2(), X, X))


def test_the_wiener_system_is_its_recursion() -> None:
    u = np.random.default_rng(11).normal(size=30)
    x = np.zeros(32)
    for k in range(1, 30):
        x[k] = 1.8036 * x[k - 1] - 0.8338 * (x[k - 2] if k > 1 else 0.0) + 10.0 * u[k - 1]
    np.testing.assert_allclose(wiener(u, 3), x[:30] + x[:30] ** 2 + x[:30] ** 3)
