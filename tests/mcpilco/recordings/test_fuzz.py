"""However a log is damaged: a sentence that names it, or a recording that keeps its laws."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mcpilco.recordings import Recording, noise_std, smoothed
from mcpilco.typing import RecordingError
from tests.mcpilco.recordings.logs import read, uniform, write

Damage = Callable[[bytes, np.random.Generator], bytes]

WORDS = ["nan", "inf", "-inf", "1e999", "-1e300", "", "1e-320", "0x1F", "1,5", "NULL", "--", "1_0"]
SEPARATORS = [b";", b"\t", b" ", b"|", b",,", b'","']
ENCODINGS = ["utf-16", "utf-32", "latin-1", "utf-8-sig", "cp037"]


def flip_bits(content: bytes, rng: np.random.Generator) -> bytes:
    damaged = bytearray(content)
    for place in rng.integers(0, len(damaged), rng.integers(1, 8)):
        damaged[place] ^= 1 << rng.integers(8)
    return bytes(damaged)


def truncate(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: rng.integers(0, len(content))]


def swap_separators(content: bytes, rng: np.random.Generator) -> bytes:
    new = SEPARATORS[rng.integers(len(SEPARATORS))]
    return content.replace(b",", new, -1 if rng.random() < 0.5 else int(rng.integers(1, 200)))


def mix_line_ends(content: bytes, rng: np.random.Generator) -> bytes:
    ends = [b"\n", b"\r\n", b"\r", b"\n\n", b"\x0c", b"\xe2\x80\xa8"]
    lines = content.split(b"\n")
    return b"".join(line + ends[rng.integers(len(ends))] for line in lines)


def replace_cells(content: bytes, rng: np.random.Generator) -> bytes:
    rows = [line.split(b",") for line in content.split(b"\n")]
    for _ in range(rng.integers(1, 20)):
        row = rows[rng.integers(len(rows))]
        row[rng.integers(len(row))] = WORDS[rng.integers(len(WORDS))].encode()
    return b"\n".join(b",".join(row) for row in rows)


def empty_a_column(content: bytes, rng: np.random.Generator) -> bytes:
    rows = [line.split(b",") for line in content.split(b"\n")]
    place, word = rng.integers(6), WORDS[rng.integers(len(WORDS))].encode()
    for row in rows[1:]:
        if len(row) > place:
            row[place] = word
    return b"\n".join(b",".join(row) for row in rows)


def drop_a_column(content: bytes, rng: np.random.Generator) -> bytes:
    place = rng.integers(6)
    rows = [line.split(b",") for line in content.split(b"\n")]
    return b"\n".join(b",".join(row[:place] + row[place + 1 :]) for row in rows)


def scale_a_column(content: bytes, rng: np.random.Generator) -> bytes:
    """By 1e-12 to 1e17: units, overflow, digits that are lost."""
    place, factor = rng.integers(6), float(10.0 ** rng.integers(-12, 18))
    rows = [line.split(b",") for line in content.split(b"\n")]
    for row in rows[1:]:
        if len(row) > place:
            row[place] = repr(float(row[place] or 0) * factor).encode()
    return b"\n".join(b",".join(row) for row in rows)


def shuffle_rows(content: bytes, rng: np.random.Generator) -> bytes:
    header, *rows = content.split(b"\n")
    picks = rng.integers(0, len(rows), rng.integers(1, 30))
    for pick in picks:
        rows.insert(int(rng.integers(len(rows))), rows[pick])
    if rng.random() < 0.2:
        rng.shuffle(rows)
    return b"\n".join([header, *rows])


def delete_rows(content: bytes, rng: np.random.Generator) -> bytes:
    header, *rows = content.split(b"\n")
    kept = rng.random(len(rows)) < rng.random()
    return b"\n".join([header, *(row for row, keep in zip(rows, kept, strict=True) if keep)])


def damage_header(content: bytes, rng: np.random.Generator) -> bytes:
    header, _, rest = content.partition(b"\n")
    kinds = [b"", header + b"," + header, header.upper(), header.split(b",", 1)[1], b"\xff\xfe"]
    return kinds[rng.integers(len(kinds))] + b"\n" + rest


def decimal_commas(content: bytes, rng: np.random.Generator) -> bytes:
    separated = content.replace(b",", b";") if rng.random() < 0.7 else content
    return separated.replace(b".", b",")


def encode(content: bytes, rng: np.random.Generator) -> bytes:
    text = content.decode().replace("force", ["force", "größe", "力"][rng.integers(3)])
    return text.encode(ENCODINGS[rng.integers(len(ENCODINGS))], errors="replace")


def binary(content: bytes, rng: np.random.Generator) -> bytes:
    noise = rng.bytes(int(rng.integers(0, 4000)))
    return noise if rng.random() < 0.5 else content[: rng.integers(len(content))] + noise


def quote(content: bytes, rng: np.random.Generator) -> bytes:
    place = rng.integers(len(content))
    return content[:place] + b'"' + content[place:]


DAMAGES: list[Damage] = [
    flip_bits,
    truncate,
    swap_separators,
    mix_line_ends,
    replace_cells,
    empty_a_column,
    drop_a_column,
    scale_a_column,
    shuffle_rows,
    delete_rows,
    damage_header,
    decimal_commas,
    encode,
    binary,
    quote,
]


def assert_valid(recording: Recording) -> None:
    rows = len(recording.time)
    assert recording.states.shape == (rows, 4)
    assert recording.inputs.shape == (rows, 1)
    assert rows >= 10
    assert recording.time[0] == 0
    assert np.isfinite(recording.time).all()
    assert np.isfinite(recording.inputs).all()
    assert not np.isinf(recording.states).any()
    assert np.isfinite(recording.states[:, [0, 2]]).sum(0).min() >= 10
    for start, end in recording.gaps:
        inside = (recording.time > start + 1e-9) & (recording.time < end - 1e-9)
        assert np.isnan(recording.states[inside]).all()
    noise_std(recording)
    smoothed(recording)


def outcome(content: bytes, path: Path) -> str:
    """What became of a file: the sentence, or "" for a recording."""
    path.write_bytes(content)
    try:
        recording = read(path)
    except RecordingError as error:
        sentence = str(error)
    else:
        assert_valid(recording)
        return ""
    assert str(path) in sentence
    assert len(sentence) < 800
    assert "\n" not in sentence
    return sentence


def damaged_files(tmp_path: Path, count: int) -> tuple[int, int]:
    """How many were read, and how many refused."""
    rng = np.random.default_rng(0)
    rows = uniform(100)
    rows[:, 1:5] += 1e-3 * rng.standard_normal((100, 4))
    good = write(tmp_path / "good.csv", rows).read_bytes()
    read_files = 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for k in range(count):
            content = DAMAGES[k % len(DAMAGES)](good, rng)
            read_files += outcome(content, tmp_path / "log.csv") == ""
    return read_files, count - read_files


@pytest.mark.parametrize("count", [200, pytest.param(1000, marks=pytest.mark.slow)])
def test_damaged_files_are_read_or_refused_with_a_sentence(tmp_path: Path, count: int) -> None:
    read_files, refused = damaged_files(tmp_path, count)
    assert min(read_files, refused) > count / 10


@pytest.mark.parametrize("suffix", [".npz", ".parquet"])
def test_damaged_containers_are_read_or_refused_with_a_sentence(
    tmp_path: Path, suffix: str
) -> None:
    rng = np.random.default_rng(1)
    names = ("time", "cart_position", "pole_angle", "force")
    columns = dict(zip(names, uniform(50).T[[0, 1, 3, 5]], strict=True))
    path = tmp_path / f"log{suffix}"
    if suffix == ".npz":
        np.savez(path, **columns)
    else:
        pyarrow = pytest.importorskip("pyarrow")
        from pyarrow import parquet

        parquet.write_table(pyarrow.table(columns), path)
    good = path.read_bytes()
    assert outcome(good, path) == ""
    refusals = [outcome((flip_bits, truncate)[k % 2](good, rng), path) for k in range(60)]
    assert sum(map(bool, refusals)) > 30
