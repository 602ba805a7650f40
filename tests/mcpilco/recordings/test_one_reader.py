"""Laws of `read_rows`: every kind of recording mends, remarks on and refuses the same damage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mcpilco.recordings import columns_of, read_arm, read_markers, read_recording, read_series
from mcpilco.recordings.markers import POSE
from mcpilco.recordings.reader import read_rows
from mcpilco.recordings.table import write_table
from mcpilco.typing import InputError, RecordingError

ROWS = 60
MARKERS = tuple(f"{marker}_{end}" for marker in "ab" for end in POSE)


def remarks_of_markers(path: Path) -> tuple[str, ...]:
    return read_markers(path)[1]


KINDS: dict[str, tuple[tuple[str, ...], Callable[[Path], tuple[str, ...]]]] = {
    "states": (("q", "u"), lambda path: read_recording(path, ["q"], ["u"]).remarks),
    "arm": (columns_of(["hip"]), lambda path: read_arm(path, ["hip"]).remarks),
    "markers": (("hip", *MARKERS), remarks_of_markers),
    "series": (("u", "y"), lambda path: read_series(path, ["u"], ["y"]).remarks),
}


def log(names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Columns of a recording of this kind, with a clock that starts late."""
    rng = np.random.default_rng(0)
    columns = {name: rng.normal(size=ROWS) for name in names}
    for name in columns:
        if name[-3:-1] == "_q":
            columns[name] = np.full(ROWS, 0.5)
    return {"time": 7.0 + 0.01 * np.arange(ROWS), **columns}


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest):
    return KINDS[request.param]


def test_rows_that_repeat_or_have_no_stamp_are_left_out_with_a_remark(kind, tmp_path) -> None:
    names, read = kind
    columns = {name: np.insert(column, 20, column[19]) for name, column in log(names).items()}
    columns["time"][-1] = np.nan
    remarks = read(write_table(tmp_path / "log.csv", columns))
    assert "1 row left out, whose time stamps repeat or run backwards" in remarks[1]
    assert remarks[0] == f"1 row without a time stamp left out, the first of them row {ROWS + 2}."


def test_a_last_row_that_is_cut_off_is_left_out_with_a_remark(kind, tmp_path) -> None:
    names, read = kind
    path = write_table(tmp_path / "log.csv", log(names))
    path.write_text(path.read_text().rstrip("\n").rpartition(",")[0])
    assert "the last, is cut off and is left out" in read(path)[0]


def test_a_clock_that_runs_backwards_again_and_again_is_refused(kind, tmp_path) -> None:
    names, read = kind
    columns = log(names)
    columns["time"][1::4] -= 5.0
    with pytest.raises(RecordingError, match=r"row \d+, column 'time': expected time to increase"):
        read(write_table(tmp_path / "log.csv", columns))


def test_a_file_with_few_rows_is_refused(kind, tmp_path) -> None:
    names, read = kind
    short = {name: column[:9] for name, column in log(names).items()}
    with pytest.raises(RecordingError, match="at least 10 rows with a time stamp .* got 9"):
        read(write_table(tmp_path / "log.csv", short))


def test_milliseconds_are_refused(tmp_path) -> None:
    for name in ("states", "arm"):
        names, read = KINDS[name]
        columns = log(names) | {"time": 10.0 * np.arange(ROWS)}
        with pytest.raises(RecordingError, match="expected seconds, got a median step of 10"):
            read(write_table(tmp_path / f"{name}.csv", columns))


def test_a_missing_column_and_an_unknown_name_are_said(tmp_path) -> None:
    path = write_table(tmp_path / "log.csv", log(("q", "u")))
    with pytest.raises(RecordingError, match="a column for each of p, got the columns time, q, u"):
        read_rows(path, ["q", "p"])
    with pytest.raises(InputError, match="got r; write NAME_OF_THE_PLANT=NAME_IN_THE_FILE"):
        read_rows(path, ["q"], columns={"r": "u"})
    assert np.isnan(read_rows(path, ["p"], optional=["p"]).columns(["p"])).all()
