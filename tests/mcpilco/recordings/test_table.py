"""A file becomes columns, or one sentence says where it is wrong."""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from mcpilco.recordings.table import read_table
from mcpilco.typing import InputError, RecordingError

GOOD = "time,angle,torque\n0.00,0.1,1\n0.02,0.2,2\n0.04,,3\n"


def written(tmp_path: Path, content: str | bytes) -> Path:
    path = tmp_path / "log.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize(
    "content",
    [
        GOOD,
        GOOD.replace(",", ";"),
        GOOD.replace(",", "\t"),
        GOOD.replace(",", ";").replace(".", ","),
        GOOD.replace(",,", ",nan,").replace(",", " ").replace(".", ","),
        GOOD.replace("\n", "\r\n"),
        GOOD.replace("\n", "\r"),
        GOOD.replace("\n", "\r\n", 2),
        "\ufeff" + GOOD,
        "# " + GOOD,
        "# made by a logger, in SI units\n# of the left arm\n" + GOOD,
        "# made by a logger\n#" + GOOD,
        "# made by a logger\n#\n" + GOOD.replace("0.04", "# paused, 3 s\n0.04"),
        GOOD.replace(",,", ",nan,").replace(",", " "),
        "# " + GOOD.replace(",,", ",nan,").replace(",", "   "),
        GOOD.replace(",,", ",nan,").replace(",", " ").replace("0.0", " 0.0"),
        GOOD.replace("time,angle", " time , angle "),
        GOOD.replace(",,", ",NaN,"),
        GOOD.replace("\n", "\n\n"),
        GOOD.replace("angle", '"angle"').replace("0.2", '"0.2"'),
    ],
)
def test_all_ways_to_write_a_csv_give_the_same_numbers(tmp_path: Path, content: str) -> None:
    table = read_table(written(tmp_path, content))
    assert list(table.columns) == ["time", "angle", "torque"]
    np.testing.assert_array_equal(table.numbers("angle"), [0.1, 0.2, np.nan])


def test_a_row_of_units_is_no_row_of_numbers(tmp_path: Path) -> None:
    table = read_table(written(tmp_path, "time;i;mode;q\ns;;-;deg\n0,0;1;a;180\n"))
    assert list(table.columns) == ["time [s]", "i", "mode [-]", "q [deg]"]
    assert table.numbers(table.written("q")) == pytest.approx(np.pi)
    assert table.rows.tolist() == [3]
    assert len(read_table(written(tmp_path, "time,q\n1,1\n2,1\n")).rows) == 2


def test_commas_beside_decimal_points_are_none(tmp_path: Path) -> None:
    path = written(tmp_path, "time;angle\n0.00;1,000\n0.02;1,1\n")
    with pytest.raises(RecordingError, match="got '1,000' .a decimal comma; write a point"):
        read_table(path).numbers("angle")


@pytest.mark.parametrize(
    "stamps",
    [
        ("2026-12-01T00:00:00.0", "2026-12-01T00:00:00.02", "2026-12-01T00:00:00.040"),
        ("2026-12-01 00:00:00Z", "2026-12-01 00:00:00.020000Z", "2026-12-01 01:00:00.04+01:00"),
        ("00:00:00", " 00:00:00.02", "00:00:00.04000"),
        (0.0, 0.02, 0.04),
    ],
)
def test_time_stamps_may_be_dates_and_times(tmp_path: Path, stamps: tuple[str, ...]) -> None:
    rows = "".join(f"{stamp},1\n" for stamp in (*stamps, ""))
    found = read_table(written(tmp_path, f"time,angle\n{rows}")).stamps("time")
    np.testing.assert_allclose(found - found[0], [0.0, 0.02, 0.04, np.nan], atol=1e-6)


def test_dates_are_seconds_since_1970(tmp_path: Path) -> None:
    path = written(tmp_path, "time,angle\n2026-12-01T00:00:00.5,1\n")
    np.testing.assert_allclose(read_table(path).stamps("time"), [1796083200.5], rtol=1e-15)


@pytest.mark.parametrize(
    ("name", "second", "said"),
    [
        ("time", "0.02", "row 3, column 'time': expected a date and time like the first one"),
        ("time@ms", "2026-12-01T00:00:01", "expected no unit of dates and times"),
    ],
)
def test_dates_that_cannot_be_meant_are_refused(
    tmp_path: Path, name: str, second: str, said: str
) -> None:
    path = written(tmp_path, f"time,angle\n2026-12-01T00:00:00,1\n{second},1\n")
    with pytest.raises((RecordingError, InputError), match=said):
        read_table(path).stamps(name)


def test_a_column_that_nobody_asks_for_may_hold_text(tmp_path: Path) -> None:
    table = read_table(written(tmp_path, "time,mode\n0.0,idle\n0.1,run\n"))
    np.testing.assert_array_equal(table.numbers("time"), [0.0, 0.1])


def test_a_last_row_that_is_cut_off_is_left_out_and_said(tmp_path: Path) -> None:
    table = read_table(written(tmp_path, GOOD + "0.06,0.3"))
    assert len(table.rows) == 3
    assert table.remarks == ("Row 5, the last, is cut off and is left out.",)


@pytest.mark.parametrize(
    ("cell", "said"),
    [
        ("0x12", "row 3, column 'angle': expected a number, got '0x12'"),
        ("1_000", "row 3, column 'angle': expected a number, got '1_000'"),
        ('"0,2"', "a decimal comma; write a point"),
        ("inf", "row 3, column 'angle': expected a measured value, got 'inf'"),
        ("-1e999", "row 3, column 'angle': expected a measured value, got '-1e999'"),
        ("3e300", "expected a measured value, got '3e300'"),
    ],
)
def test_a_wrong_cell_is_named_by_row_and_column(tmp_path: Path, cell: str, said: str) -> None:
    path = written(tmp_path, GOOD.replace("0.2", cell))
    with pytest.raises(RecordingError, match=said) as caught:
        read_table(path).numbers("angle")
    assert str(path) in str(caught.value)


def test_rows_are_counted_as_an_editor_shows_them(tmp_path: Path) -> None:
    path = written(tmp_path, "# a log\ntime,angle\n\n0.0,1\n# on\n0.1,x\n")
    with pytest.raises(RecordingError, match="row 6, column 'angle'"):
        read_table(path).numbers("angle")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty; expected a header row"),
        (b"  \n\n", "is empty; expected a header row"),
        (b"0.0,0.1,1\n0.02,0.2,2\n", "row 1: expected the names of the columns, got the numbers"),
        (b"time,a,a\n0,1,2\n", "got 'a' twice in the header"),
        (b"time,a\n0.0,1\n0.1,2,3\n0.2,4\n", "row 3: expected 2 cells as in the header, got 3"),
        (b"time,a\n0.0,1\n0.1\n0.2,4\n", "row 3: expected 2 cells as in the header, got 1"),
        (GOOD.encode("utf-16"), "expected text in UTF-8, got UTF-16"),
        (b"time,w\xe4rme\n0,1\n", "row 1: expected text in UTF-8, got the byte 0xe4"),
        (b"time,a\n0,1\n\0\0\0", "row 3: expected text, got a zero byte"),
        (b'time,a\n0,"1\n1,2\n', "correct the quotation marks"),
    ],
)
def test_a_file_that_is_no_csv_is_refused_with_a_sentence(
    tmp_path: Path, content: bytes, said: str
) -> None:
    with pytest.raises(RecordingError, match=said):
        read_table(written(tmp_path, content))


def test_a_folder_and_a_missing_file_are_told_apart(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="is a folder; name the files in it"):
        read_table(tmp_path)
    with pytest.raises(RecordingError, match=r"There is no file .*nothing\.csv"):
        read_table(tmp_path / "nothing.csv")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    path.chmod(0)
    with pytest.raises(RecordingError, match="cannot be read"):
        read_table(path)


# npz and parquet ----------------------------------------------------------------------------------


def test_an_npz_gives_its_arrays(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", time=np.arange(3), angle=np.float32([1, np.nan, 3]), dt=0.1)
    table = read_table(tmp_path / "log.npz")
    assert list(table.columns) == ["time", "angle"]
    np.testing.assert_array_equal(table.numbers("angle"), [1, np.nan, 3])


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"time": np.arange(3), "angle": np.arange(4)}, "a vector of equal length"),
        ({"time": np.eye(3)}, "a vector of equal length"),
        ({}, "a vector of equal length"),
    ],
)
def test_an_npz_without_columns_is_refused(tmp_path: Path, arrays: dict, said: str) -> None:
    np.savez(tmp_path / "log.npz", **arrays)
    with pytest.raises(RecordingError, match=said):
        read_table(tmp_path / "log.npz")


def test_an_npz_with_infinity_is_refused_by_row(tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", time=np.arange(3), angle=np.array([1, np.inf, 3]))
    with pytest.raises(RecordingError, match="row 2, column 'angle'"):
        read_table(tmp_path / "log.npz").numbers("angle")


def test_a_mat_file_gives_its_vectors(tmp_path: Path) -> None:
    """As benchmarks are published, with scalars, matrices, texts and structs beside."""
    vectors = {"time": np.arange(3.0)[:, None], "angle": np.array([1.0, np.nan, 3.0])}
    others = {"dt": 0.02, "poses": np.eye(3), "name": "a log", "about": {"rig": "left", "q": 1}}
    savemat(tmp_path / "log.mat", vectors | others)
    table = read_table(tmp_path / "log.mat")
    assert list(table.columns) == ["time", "angle"]
    np.testing.assert_array_equal(table.numbers("angle"), [1.0, np.nan, 3.0])


def test_a_mat_file_of_version_7_3_is_refused_with_what_to_do(tmp_path: Path) -> None:
    header = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM"
    (tmp_path / "log.mat").write_bytes(header.ljust(512, b"\0") + b"\x89HDF")
    with pytest.raises(RecordingError, match=r"got version 7\.3; in MATLAB write it by save"):
        read_table(tmp_path / "log.mat")


def test_a_parquet_gives_its_columns(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    days = pyarrow.array([1_000_000_001, 1_020_000_000], pyarrow.timestamp("ns"))
    columns = {"time": [0.0, 0.1], "angle": [1.0, None], "mode": ["a", "b"], "day": days}
    parquet.write_table(pyarrow.table(columns), tmp_path / "log.parquet")
    read = read_table(tmp_path / "log.parquet")
    np.testing.assert_allclose(read.stamps("day"), [1.0, 1.02])
    np.testing.assert_array_equal(read.numbers("angle"), [1.0, np.nan])
    with pytest.raises(RecordingError, match="row 1, column 'mode': expected a number, got 'a'"):
        read.numbers("mode")


@pytest.mark.parametrize("name", ["log.npz", "log.mat", "log.parquet"])
def test_a_damaged_container_is_refused(tmp_path: Path, name: str) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, time=np.arange(100))
    (tmp_path / name).write_bytes(buffer.getvalue()[:200])
    with pytest.raises(RecordingError, match="damaged"):
        read_table(tmp_path / name)


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("deg", np.pi / 180.0), ("-deg", -np.pi / 180.0), ("-1", -1.0), ("0.5", 0.5), ("mm", 1e-3)],
)
def test_a_column_behind_which_a_unit_stands_comes_in_si_units(
    tmp_path: Path, unit: str, factor: float
) -> None:
    table = read_table(written(tmp_path, GOOD))
    np.testing.assert_allclose(table.numbers(f"torque@{unit}"), factor * np.array([1.0, 2.0, 3.0]))


def test_a_unit_that_nobody_knows_is_refused_with_those_that_are_known(tmp_path: Path) -> None:
    table = read_table(written(tmp_path, GOOD))
    for wrong in ("grad", "nan", "-inf", "0", "--1", ""):
        expected = rf"torque@{wrong}: expected a number other than 0 or one of deg, .*'{wrong}'"
        with pytest.raises(InputError, match=expected):
            table.numbers(f"torque@{wrong}")


def test_a_column_whose_name_has_an_at_sign_is_taken_as_it_is(tmp_path: Path) -> None:
    table = read_table(written(tmp_path, GOOD.replace("torque", "torque@deg")))
    np.testing.assert_array_equal(table.numbers("torque@deg"), [1.0, 2.0, 3.0])
