"""Laws of `mcpilco volterra`: what it prints and writes, and how it refuses bad data."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from mcpilco.cli import main
from mcpilco.identification import load_volterra

FEW = ["--lags", "2", "--degree", "2"]


def recording(path: Path, samples: int = 300, seed: int = 0) -> Path:
    rng = np.random.default_rng(seed)
    u = rng.normal(size=samples)
    x = np.r_[0.0, 0.8 * u[:-1]]
    y = x + 0.4 * x**2 + 0.05 * rng.normal(size=samples)
    np.savetxt(path, np.stack([u, y], 1), delimiter=",", header="valve,flow", comments="")
    return path


def called(path: Path, out: Path, *arguments: str) -> int:
    columns = ["--inputs", "valve", "--outputs", "flow"]
    return main(["volterra", str(path), *columns, "--out", str(out), *FEW, *arguments])


def refused(capsys, *arguments) -> str:
    assert called(*arguments) == 2
    return capsys.readouterr().err.strip().splitlines()[-1]


def test_a_model_a_prediction_and_a_picture_are_written(tmp_path, capsys) -> None:
    path, out = recording(tmp_path / "a.csv"), tmp_path / "out"
    assert called(path, out, "--kernel", "ipk", "mpk") == 0
    said = capsys.readouterr().out.splitlines()
    assert [line.partition(",")[0] for line in said[:2]] == ["ipk", "mpk"]
    assert all("Fit 9" in line and "noise 0.05" in line for line in said[:2])
    evidence = {line.partition(",")[0]: float(line.split()[-1]) for line in said[:2]}
    best = max(evidence, key=evidence.__getitem__)
    assert said[2] == f"Highest evidence: {best}"
    assert sorted(p.name for p in out.iterdir()) == ["model.npz", "prediction.csv", "volterra.png"]
    model = load_volterra(out / "model.npz")
    assert model.config.kernel == best

    rows = list(csv.DictReader((out / "prediction.csv").open()))
    u = np.loadtxt(path, delimiter=",", skiprows=1)[-len(rows) :, 0]
    mean, _ = model.predict(u)
    assert [row["flow_predicted"] for row in rows[:2]] == ["", ""]
    told = [float(row["flow_predicted"]) for row in rows[2:]]
    np.testing.assert_allclose(told, mean[2:, 0], rtol=1e-6)


def test_another_recording_can_be_the_test(tmp_path, capsys) -> None:
    path, test = recording(tmp_path / "a.csv"), recording(tmp_path / "b.csv", 100, seed=1)
    assert called(path, tmp_path / "out", "--test", str(test)) == 0
    assert "on 100 samples not seen" in capsys.readouterr().out


def test_bad_data_are_refused_with_a_sentence(tmp_path, capsys) -> None:
    good, out = recording(tmp_path / "a.csv"), tmp_path / "out"
    assert "There is no file" in refused(capsys, tmp_path / "none.csv", out)
    assert "a column for each of x, got the columns valve, flow; rename them" in refused(
        capsys, good, out, "--inputs", "x"
    )
    assert "kernel must be one of" in refused(capsys, good, out, "--kernel", "rbf")
    assert "--held-out must lie" in refused(capsys, good, out, "--held-out", "1")
    assert "--held-out leaves 3 of 300 rows" in refused(
        capsys, good, out, "--held-out", "0.01", "--lags", "5"
    )
    still = tmp_path / "still.csv"
    still.write_text("valve,flow\n" + "1,2\n1,3\n" * 50)
    assert "stands still at 1; record it while" in refused(capsys, still, out)
    short = recording(tmp_path / "short.csv", 12)
    assert "Record for longer" in refused(capsys, short, out, "--lags", "2")
    assert not out.exists()


def test_data_that_tell_too_little_are_warned_of(tmp_path, capsys) -> None:
    rng = np.random.default_rng(0)
    u = np.sign(rng.normal(size=200))
    path = tmp_path / "binary.csv"
    rows = np.stack([u, u + 0.1 * rng.normal(size=200)], 1)
    np.savetxt(path, rows, delimiter=",", header="valve,flow", comments="")
    assert called(path, tmp_path / "out") == 0
    assert "warning: valve takes 2 values" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--inputs", "--outputs", "--kernel"])
def test_an_empty_list_is_refused(tmp_path, capsys, option: str) -> None:
    assert "must name at least one" in refused(
        capsys, recording(tmp_path / "a.csv", 50), tmp_path / "out", option
    )
