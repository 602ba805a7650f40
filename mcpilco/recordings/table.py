"""Files of named columns: CSV, npz, mat, parquet, ROS bags. Nothing in them is executed."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, time
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from mcpilco.files import csv_bytes, read_arrays, write_bytes
from mcpilco.recordings.ros_bag import is_bag, read_bag
from mcpilco.typing import InputError, RecordingError, RunFolderError

MISSING = frozenset({"", "nan", "na", "n/a", "null", "none"})
"""cells that say that a value is missing, in small letters"""
LARGEST = 1e15
"""beyond it a number is no measurement in SI units"""
UNITS = {
    **{"deg": math.pi / 180.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0},
    **{"mm": 1e-3, "mm/s": 1e-3, "mNm": 1e-3, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
}
"""what one of each unit is in SI units"""
SI = frozenset(
    {"s", "sec", "m", "rad", "m/s", "rad/s", "rad/sec", "N", "Nm", "N m", "N*m", "V", "A", "-"}
)
"""units that a header may name, and that need no conversion"""
_LATEST = 1e19  # nanoseconds since 1970 are 2e18
_DAY = datetime(1970, 1, 1).date()  # of times that name none
_SEPARATORS = ",;\t"
_COMMENT = "#"
_KNOWN = {*UNITS, *SI}
_IN_UNITS = {*_KNOWN, ""}  # cells of a row of units
_IN_BRACKETS = re.compile(r"\s*[\[(]([^\[\]()]+)[\])]$")
_CELLS = re.compile(r"[,;\s]+")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")


@dataclass(frozen=True)
class Table:
    """Named columns of one file; a column is read as numbers when it is asked for."""

    path: Path
    """where it came from"""
    columns: Mapping[str, Sequence[Any]]
    """cells, text or numbers, one for each row"""
    rows: Int[np.ndarray, " N"]
    """place of each row in the file, counted from 1; the header of a CSV is counted too"""
    remarks: tuple[str, ...] = ()
    """what was left out"""

    def numbers(self, name: str, largest: float = LARGEST) -> Float[np.ndarray, " N"]:
        """A column, NaN where a cell is empty or says that the value is missing.

        A magnitude beyond `largest` is no measurement.
        """
        name, factor = self.source(name)
        values = self._read(name, _number, "a number")
        wrong = np.flatnonzero(np.abs(values) > largest)
        if len(wrong):
            got = _shown(self.columns[name][wrong[0]])
            raise self.error(name, wrong[0], "a measured value", got)
        return factor * values

    def stamps(self, name: str) -> Float[np.ndarray, " N"]:
        """A column of time stamps [s]: of numbers, or since 1970 where they are dates and times.

        These are those of ISO 8601, or of parquet, in UTC where they name no zone; or times of a
        day alone.
        """
        own, factor = self.source(name)
        first = next((cell for cell in self.columns[own] if not _is_missing(cell)), None)
        if not _is_moment(first):
            return self.numbers(name, largest=_LATEST)
        if factor != 1.0:
            raise InputError(
                f"{name}: expected no unit of dates and times, such as {_shown(first)}, got one "
                f"behind the @; write {own}."
            )
        return self._read(own, _moment, "a date and time like the first one")

    def _read(
        self, name: str, read: Callable[[Any], float], expected: str
    ) -> Float[np.ndarray, " N"]:
        values = np.empty(len(self.rows))
        for k, cell in enumerate(self.columns[name]):
            try:
                values[k] = math.nan if _is_missing(cell) else read(cell)
            except (TypeError, ValueError, OverflowError):
                raise self.error(name, k, expected, _shown(cell) + _hint(cell)) from None
        return values

    def written(self, name: str) -> str:
        """The column that is called so, or so with a unit that is known: `q1 [deg]`, `q1 (s)`."""
        behind = {c: unit for c in self.columns if (unit := _IN_BRACKETS.search(c))}
        meant = [c for c, unit in behind.items() if c[: unit.start()] == name and unit[1] in _KNOWN]
        return meant[0] if name not in self.columns and meant else name

    def source(self, name: str) -> tuple[str, float]:
        """The column that a name means, and its factor to SI units: `q1`, `q1@deg`, `q1@-1`.

        Where none is said, the unit is that of `UNITS` which the header has in brackets.

        Raises:
            InputError: what is behind the @ is neither a unit of `UNITS`, its negative, nor a
                number, which is finite and not 0.
        """
        column, at, unit = name.rpartition("@")
        if not at or name in self.columns:
            said = _IN_BRACKETS.search(name)
            return name, UNITS.get(said[1], 1.0) if said else 1.0
        size = unit.removeprefix("-")
        try:
            factor = UNITS.get(size) or float(size)
        except ValueError:
            factor = 0.0
        if factor > 0.0 and math.isfinite(factor):
            return column, -factor if size != unit else factor
        raise InputError(
            f"{name}: expected a number other than 0 or one of {', '.join(UNITS)} behind the @, "
            f"got {unit!r}; write for example {column}@deg, or {column}@-1 for another sign."
        )

    def error(self, name: str, k: int, expected: str, got: str) -> RecordingError:
        """The sentence about the cell in the k-th row of a column."""
        return RecordingError(
            f"{self.path}, row {self.rows[k]}, column {name!r}: expected {expected}, got {got}; "
            "correct the cell, or empty it where the value is missing."
        )


def read_table(path: str | Path) -> Table:
    """The columns of a file: `.npz`, `.mat`, `.parquet`, ROS bags by their names, else a CSV.

    A CSV has a header row, is separated by commas, semicolons or tabs, or else by spaces, and is
    UTF-8. Lines that begin with # are comments; the last one above the numbers may be the header.

    Raises:
        RecordingError: it is missing, damaged, or holds no named columns.
    """
    path = Path(path)
    if is_bag(path):
        return _table(path, read_bag(path))
    match path.suffix.lower():
        case ".npz":
            return _read_npz(path)
        case ".mat":
            return _read_mat(path)
        case ".parquet":
            return _read_parquet(path)
    return _read_csv(path)


def write_table(path: str | Path, columns: Mapping[str, Float[np.ndarray, " N"]]) -> Path:
    """Write a CSV that `read_table` reads to the last digit; NaN becomes an empty cell."""
    table = np.column_stack(list(columns.values())).tolist()
    rows = [["" if v != v else repr(v) for v in row] for row in table]
    return write_bytes(Path(path), csv_bytes(list(columns), rows))


def _is_missing(cell: Any) -> bool:
    return cell is None or (isinstance(cell, str) and cell.strip().lower() in MISSING)


def _number(cell: Any) -> float:
    if isinstance(cell, str) and "_" in cell:  # Python reads 1_000
        raise ValueError
    return float(cell)


def _moment(cell: Any) -> float:
    """Seconds since 1970 of a date and time, or since midnight of a time alone."""
    if isinstance(cell, str):
        text = cell.strip()
        try:
            cell = datetime.fromisoformat(text)
        except ValueError:
            cell = datetime.combine(_DAY, time.fromisoformat(text))
    if not isinstance(cell, datetime):
        raise TypeError
    return (cell if cell.tzinfo else cell.replace(tzinfo=UTC)).timestamp()


def _is_moment(cell: Any) -> bool:
    if isinstance(cell, str) and _is_number(cell):  # 20261201 is a date too
        return False
    try:
        return math.isfinite(_moment(cell))
    except (TypeError, ValueError, OverflowError):
        return False


def _shown(cell: Any) -> str:
    text = repr(cell) if isinstance(cell, str) else str(cell)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _hint(cell: Any) -> str:
    if isinstance(cell, str) and cell.replace(",", "", 1).strip(" +-").isdecimal():
        return " (a decimal comma; write a point)"
    return ""


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip()


# CSV ----------------------------------------------------------------------------------------------


def _read_csv(path: Path) -> Table:
    text = _uncommented(_decoded(path, _content(path)))
    separator = _separator(text)
    spaced = separator == " "  # by one or more
    file = io.StringIO(text)
    lines = csv.reader(file, delimiter=separator, skipinitialspace=spaced, strict=True)
    rows, numbers = [], []
    try:
        for line in lines:
            if any(cell.strip() for cell in line):
                rows.append(line)
                numbers.append(lines.line_num)
    except csv.Error as error:
        raise RecordingError(
            f"{path}, row {lines.line_num}: expected comma-separated values, got a line that is "
            f"none ({error}); correct the quotation marks of the line."
        ) from error
    if not rows:
        raise RecordingError(f"{path} is empty; expected a header row and a row a sample.")
    names = _header(path, rows.pop(0), numbers.pop(0))
    if rows and len(rows[0]) == len(names) and all(cell.strip() in _IN_UNITS for cell in rows[0]):
        numbers.pop(0)
        names = [_with_unit(name, cell) for name, cell in zip(names, rows.pop(0), strict=True)]
    rows, remarks = _complete(path, rows, numbers, len(names))
    rows = rows if separator == "," else _with_points(rows)
    columns = {name: [row[place] for row in rows] for place, name in enumerate(names) if name}
    return Table(path, columns, np.array(numbers[: len(rows)], dtype=np.int64), remarks)


def _content(path: Path) -> bytes:
    try:
        content = path.read_bytes()
    except IsADirectoryError:
        raise RecordingError(
            f"{path} is a folder; name the files in it: {path / '*.csv'}."
        ) from None
    except FileNotFoundError:
        raise RecordingError(f"There is no file {path}; name a recording that exists.") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise RecordingError(
            f"{path} cannot be read ({reason}); make the file readable, or name another."
        ) from error
    if not content.strip():
        raise RecordingError(f"{path} is empty; expected a header row and a row a sample.")
    return content


def _decoded(path: Path, content: bytes) -> str:
    """The text, with one kind of line end."""
    remedy = "save it as comma-separated values in UTF-8"
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise RecordingError(f"{path}: expected text in UTF-8, got UTF-16; {remedy}.")
    zero = content.find(b"\0")
    if zero >= 0:
        row = content.count(b"\n", 0, zero) + 1
        raise RecordingError(
            f"{path}, row {row}: expected text, got a zero byte, as in a binary file or a damaged "
            f"disk; {remedy}."
        )
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        raise RecordingError(
            f"{path}, row {row}: expected text in UTF-8, got the byte "
            f"0x{content[error.start]:02x}; {remedy}."
        ) from error
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _uncommented(text: str) -> str:
    """The text, its comments replaced by empty lines; a header is none that begins with a #."""
    lines = [line.strip(" ") for line in text.split("\n")]
    said = [n for n, line in enumerate(lines) if line.startswith(_COMMENT)]
    plain = [n for n, line in enumerate(lines) if line.strip() and not line.startswith(_COMMENT)]
    above = [n for n in said if not plain or n < plain[0]]
    headless = not plain or any(map(_is_number, _CELLS.split(lines[plain[0]])))
    header = above[-1:] if headless else []
    for n in said:
        lines[n] = lines[n].removeprefix(_COMMENT).strip(" ") if n in header else ""
    return "\n".join(lines)


def _separator(text: str) -> str:
    """The one that is most often in the header; spaces, where none of the usual ones is."""
    header = text.lstrip().partition("\n")[0]
    return max(_SEPARATORS, key=header.count) if any(map(header.count, _SEPARATORS)) else " "


def _header(path: Path, cells: Sequence[str], row: int) -> list[str]:
    names = [cell.strip() for cell in cells]
    if all(_is_number(name) for name in names):
        raise RecordingError(
            f"{path}, row {row}: expected the names of the columns, got the numbers "
            f"{_shown(', '.join(names))}; write a header row, such as time,angle,torque."
        )
    _require_distinct(path, [name for name in names if name])
    return names


def _with_unit(name: str, cell: str) -> str:
    unit = cell.strip()
    return f"{name} [{unit}]" if name and unit else name


def _require_distinct(path: Path, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise RecordingError(
                f"{path}: expected each column once, got {_shown(name)} twice in the header; "
                "rename or remove one of them."
            )
        seen.add(name)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _complete(
    path: Path, rows: list[list[str]], numbers: Sequence[int], width: int
) -> tuple[list[list[str]], tuple[str, ...]]:
    """The rows, without a last one that was cut off."""
    remarks: tuple[str, ...] = ()
    if rows and len(rows[-1]) < width:
        remarks = (f"Row {numbers[len(rows) - 1]}, the last, is cut off and is left out.",)
        rows = rows[:-1]
    for row, number in zip(rows, numbers, strict=False):
        if len(row) != width and any(cell.strip() for cell in row[width:]) | (len(row) < width):
            raise RecordingError(
                f"{path}, row {number}: expected {width} cells as in the header, got {len(row)}; "
                "complete or remove the row, and write decimal points, no decimal commas."
            )
    return rows, remarks


def _with_points(rows: list[list[str]]) -> list[list[str]]:
    """The rows with decimal points for decimal commas, unless there are points beside these."""
    if any("." in cell and _is_number(cell) for row in rows for cell in row):
        return rows

    def pointed(cell: str) -> str:
        return cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell

    return [[pointed(cell) for cell in row] for row in rows]


# npz, mat and parquet -----------------------------------------------------------------------------


def _read_npz(path: Path) -> Table:
    try:
        arrays = read_arrays(path)
    except RunFolderError as error:
        raise RecordingError(f"{_first_line(error).rstrip('.')}; write it again.") from error
    return _table(path, arrays)


def _read_mat(path: Path) -> Table:
    """The vectors in a file of MATLAB's; scalars, matrices, texts and structs are passed over."""
    from scipy.io import loadmat

    content = io.BytesIO(_content(path))
    try:
        found = loadmat(content)
    except NotImplementedError:
        raise RecordingError(
            f"{path}: expected a MAT-file up to version 7, got version 7.3; in MATLAB write it by "
            "save('log.mat', ..., '-v7'), or save it as CSV."
        ) from None
    except Exception as error:  # scipy raises almost anything from damaged bytes
        raise RecordingError(
            f"{path} is no MAT-file, or damaged: {_first_line(error)}; write it again."
        ) from error
    arrays = {name: each for name, each in found.items() if isinstance(each, np.ndarray)}
    return _table(path, {name: each.ravel() for name, each in arrays.items() if _is_vector(each)})


def _is_vector(array: np.ndarray) -> bool:
    return array.dtype.kind in "biuf" and array.size == max(array.shape) > 1


def _read_parquet(path: Path) -> Table:
    try:
        from pyarrow import parquet
    except ImportError:
        raise RecordingError(
            f"{path}: reading parquet needs pyarrow; install it, or save the file as CSV."
        ) from None
    content = _content(path)
    try:
        found = parquet.read_table(io.BytesIO(content))
        _require_distinct(path, found.column_names)
        columns = {name: _cells(found[name]) for name in found.column_names}
    except RecordingError:
        raise
    except Exception as error:  # pyarrow raises almost anything from damaged bytes
        raise RecordingError(
            f"{path} is no parquet file, or damaged: {_first_line(error)}; write it again."
        ) from error
    return _table(path, columns)


def _cells(column: Any) -> list[Any]:
    """Those of a column of parquet; Python's times have no nanoseconds."""
    import pyarrow

    if pyarrow.types.is_timestamp(column.type):
        column = column.cast(pyarrow.timestamp("us", column.type.tz), safe=False)
    return column.to_pylist()


def _table(path: Path, columns: Mapping[str, Any]) -> Table:
    shapes = {name: np.shape(column) for name, column in columns.items()}
    vectors = {name: columns[name] for name, shape in shapes.items() if len(shape) == 1}
    lengths = {len(column) for column in vectors.values()}
    if len(lengths) != 1:
        listed = ", ".join(f"{name} {shape}" for name, shape in shapes.items()) or "nothing"
        raise RecordingError(
            f"{path}: expected a vector of equal length for each column, got {_shown(listed)}; "
            "write one array a column."
        )
    return Table(path, vectors, np.arange(1, lengths.pop() + 1))
