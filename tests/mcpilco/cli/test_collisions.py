"""Laws of `mcpilco collisions`: from recordings without contact to pushes that are found."""

from __future__ import annotations

import json

import numpy as np
import pytest

from mcpilco.cli import main
from mcpilco.files import read_arrays, write_arrays
from mcpilco.recordings.table import read_table

pytestmark = pytest.mark.xdist_group("collisions")  # one process learns from them for all tests

LEARN = ["--points", "150", "--quantile", "0.99"]


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """A folder with recordings, a model learned from them, and what it found."""
    folder = tmp_path_factory.mktemp("collisions")
    assert main(["collisions", "simulate", "--out", str(folder / "data"), "--moves", "14"]) == 0
    for name in ("free", "check", "pushed"):  # as arrays, which are read in no time
        table = read_table(folder / "data" / f"{name}.csv")
        arrays = {column: table.numbers(column) for column in table.columns}
        write_arrays(folder / f"{name}.npz", arrays)
    assert learn(folder, "--check", str(folder / "check.npz")) == 0
    return folder


def learn(folder, *options: str, free: str = "free.npz", out: str = "model.npz") -> int:
    robot = ["--robot", str(folder / "data/arm.xml"), "--out", str(folder / out)]
    return main(["collisions", "learn", str(folder / free), *robot, *LEARN, *options])


def refused(capsys, *arguments: object) -> str:
    assert main(["collisions", *map(str, arguments)]) == 2
    return capsys.readouterr().err.strip().splitlines()[-1].removeprefix("mcpilco: error: ")


def test_strong_pushes_are_found_and_written(home, capsys):
    found = home / "found"
    model, pushed = str(home / "model.npz"), str(home / "pushed.npz")
    assert main(["collisions", "detect", model, pushed, "--out", str(found)]) == 0
    out = capsys.readouterr().out
    assert "of 8 pushes found" in out
    assert int(out.split(" of 8 pushes found")[0].split()[-1]) >= 6
    assert f"mcpilco view {found / 'pushed'}.rrd" in out
    events = json.loads((found / "collisions.json").read_text())["pushed"]
    assert {"start_s", "end_s", "joints", "excess", "resting"} == set(events[0])
    table = read_table(found / "pushed.csv")
    alarm = np.any([table.numbers(f"{j}_alarm") for j in ("base", "elbow")], axis=0)
    residual, threshold = (np.abs(table.numbers(f"base_{k}")) for k in ("residual", "threshold"))
    assert alarm.any()
    assert (residual[table.numbers("base_alarm") > 0] >= threshold[0] - 1e-5).all()
    assert (found / "pushed.rrd").stat().st_size > 10_000


def test_thresholds_are_set_anew(home, capsys, tmp_path):
    model = tmp_path / "model.npz"
    model.write_bytes((home / "model.npz").read_bytes())
    command = ["collisions", "threshold", str(model), str(home / "check.npz")]
    assert main([*command, "--quantile", "1", "--debounce", "5"]) == 0
    about = json.loads(str(read_arrays(model)["about"]))
    assert about["thresholds"]["quantile"] == 1.0
    assert about["thresholds"]["debounce"] == 5
    higher, lower = (read_arrays(p)["limits/moving"] for p in (model, home / "model.npz"))
    assert (higher > lower).all()
    assert "Thresholds [A]: base" in capsys.readouterr().out


def test_thresholds_come_from_the_ends_of_recordings_where_no_others_are_given(home, capsys):
    assert learn(home, "--kind", "PP", out="alone.npz") == 0
    told = capsys.readouterr().out.splitlines()[0].split()
    learned, held = int(told[2]), int(told[-1].rstrip("."))
    assert held / (learned + held) == pytest.approx(0.3, abs=0.01)


@pytest.mark.slow
def test_equal_recordings_give_equal_models(home):
    for name in ("first.npz", "again.npz"):
        assert learn(home, "--kind", "PP", out=name) == 0
    assert (home / "again.npz").read_bytes() == (home / "first.npz").read_bytes()


def changed(home, tmp_path, **columns):
    arrays = read_arrays(home / "free.npz")
    arrays |= {name: change(arrays[name]) for name, change in columns.items()}
    write_arrays(tmp_path / "free.npz", arrays)
    robot = home / "data/arm.xml"
    return ["learn", tmp_path / "free.npz", "--robot", robot, "--out", tmp_path / "m.npz", *LEARN]


def test_data_that_cannot_teach_are_refused_with_what_to_record(home, tmp_path, capsys):
    def said(**columns) -> str:
        return refused(capsys, *changed(home, tmp_path, **columns))

    assert "elbow is slower than 0.01 rad/s in 100 %" in said(elbow_velocity=lambda x: 0.0 * x)
    assert "record rests between the motions" in said(
        elbow_velocity=lambda x: np.where(x < 0, x - 1.0, x + 1.0)
    )
    assert "NaN or empty cells" in said(
        base_position=lambda x: np.where(np.arange(len(x)) % 3, np.nan, x)
    )
    assert "expected the measured current of base" in said(base_current=lambda x: np.nan * x)
    assert not (tmp_path / "m.npz").exists()


def test_what_does_not_exist_or_fit_is_refused(home, tmp_path, capsys):
    free, robot, model = home / "free.npz", home / "data/arm.xml", home / "model.npz"
    out = tmp_path / "m.npz"
    assert "--robot must be an MJCF file, got 'nowhere.xml'" in refused(
        capsys, "learn", free, "--robot", "nowhere.xml", "--out", out
    )
    (tmp_path / "bad.xml").write_text("<mujoco><worldbody></mujoco>")
    assert "no model that MuJoCo can load" in refused(
        capsys, "learn", free, "--robot", tmp_path / "bad.xml", "--out", out
    )
    assert "--points must be at least 100" in refused(
        capsys, "learn", free, "--robot", robot, "--out", out, "--points", 5
    )
    assert "no model of `mcpilco collisions learn`" in refused(
        capsys, "detect", write_arrays(tmp_path / "x.npz", {"about": np.array("{}")}), free,
        "--out", tmp_path,
    )  # fmt: skip
    assert "different names" in refused(capsys, "threshold", model, free, free)
    assert "exists already" in refused(capsys, "simulate", "--out", home / "data")
