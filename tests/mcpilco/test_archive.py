"""Laws of files: whole or not at all, equal content to equal bytes, nothing executed."""

from __future__ import annotations

import io
import os
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mcpilco import archive
from mcpilco.archive import read_arrays, read_groups, write_arrays, write_bytes, write_groups
from mcpilco.typing import RunFolderError

same_folder = settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=50, deadline=None
)
names = st.text("abcdefghij_.0123456789", min_size=1, max_size=8).filter(lambda name: name != "..")
numbers = hnp.arrays(
    st.sampled_from([np.float64, np.float32, np.int64, np.uint8, np.bool_]),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)


class Bomb:
    """Leaves a mark where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self):
        return (os.mkdir, (str(self.mark),))


def assert_equal(first: dict, second: dict) -> None:
    assert list(first) == list(second)
    for name, array in first.items():
        assert array.dtype == second[name].dtype
        np.testing.assert_array_equal(array, second[name])


@same_folder
@given(arrays=st.dictionaries(names, numbers, max_size=3))
def test_arrays_come_back_as_they_were(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    assert_equal(arrays, read_arrays(write_arrays(tmp_path / "a.npz", arrays)))


@pytest.mark.parametrize("name", ["file", "allow_pickle", "policy/weights"])
def test_any_name_may_be_given_to_an_array(tmp_path: Path, name: str) -> None:
    arrays = {name: np.ones(2)}
    assert_equal(arrays, read_arrays(write_arrays(tmp_path / "a.npz", arrays)))


@same_folder
@given(
    about=st.dictionaries(names, st.integers() | st.floats(allow_nan=False) | st.text()),
    groups=st.dictionaries(names, st.dictionaries(names, numbers, min_size=1), max_size=3),
)
def test_groups_come_back_as_they_were(tmp_path: Path, about: dict, groups: dict) -> None:
    read_about, read = read_groups(write_groups(tmp_path / "a.npz", about, groups))
    assert read_about == about
    assert list(read) == list(groups)
    for name, group in groups.items():
        assert_equal(group, read[name])


def test_equal_arrays_give_equal_bytes(tmp_path: Path) -> None:
    arrays = {"x": np.arange(5.0), "y": np.eye(3)}
    first, second = (write_arrays(tmp_path / name, arrays) for name in ("a.npz", "b.npz"))
    assert first.read_bytes() == second.read_bytes()


@same_folder
@given(content=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "any.npz"
    path.write_bytes(content)
    with pytest.raises(RunFolderError, match="damaged"):
        read_arrays(path)


@same_folder
@given(data=st.data())
def test_a_damaged_file_is_read_as_it_was_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    """A zip checks the sums of its members; a byte that means nothing may change."""
    arrays = {"x": np.arange(7.0), "y": np.eye(2)}
    content = bytearray(write_arrays(tmp_path / "a.npz", arrays).read_bytes())
    place = data.draw(st.integers(0, len(content) - 1))
    content[place] ^= data.draw(st.integers(1, 255))
    (tmp_path / "b.npz").write_bytes(content)
    try:
        read = read_arrays(tmp_path / "b.npz")
    except RunFolderError:
        return
    for name in set(read) & set(arrays):
        np.testing.assert_array_equal(read[name], arrays[name])


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9, 0.999])
def test_a_truncated_file_is_refused(tmp_path: Path, keep: float) -> None:
    path = write_arrays(tmp_path / "a.npz", {"x": np.arange(100.0)})
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    with pytest.raises(RunFolderError, match="damaged"):
        read_arrays(path)


def pickled_member(mark: Path) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, x=np.array([Bomb(mark)], dtype=object))
    return buffer.getvalue()


def foreign_member(mark: Path) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr("x.npy", pickle.dumps(Bomb(mark)))
    return buffer.getvalue()


@pytest.mark.parametrize(
    "content",
    [pickled_member, foreign_member, lambda mark: pickle.dumps(Bomb(mark))],
    ids=["object array", "pickle in a zip", "pickle"],
)
def test_nothing_in_a_file_is_executed(tmp_path: Path, content) -> None:
    mark = tmp_path / "executed"
    path = tmp_path / "a.npz"
    path.write_bytes(content(mark))
    with pytest.raises(RunFolderError, match="plain arrays"):
        read_arrays(path)
    assert not mark.exists()
    pickle.loads(pickle.dumps(Bomb(mark)))  # noqa: S301  this is how it would have gone off
    assert mark.exists()


def test_objects_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="allow_pickle"):
        write_arrays(tmp_path / "a.npz", {"x": np.array([object()])})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("about", ["5", "[1, 2]", "{", "[" * 100_000])
def test_a_file_that_does_not_say_what_it_is_is_refused(tmp_path: Path, about: str) -> None:
    path = write_arrays(tmp_path / "a.npz", {"about": np.array(about)})
    with pytest.raises(RunFolderError, match="does not say"):
        read_groups(path)
    with pytest.raises(RunFolderError, match="does not say"):
        read_groups(write_arrays(path, {"x": np.ones(1)}))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match=r"There is no file .*missing.npz"):
        read_arrays(tmp_path / "missing.npz")


@pytest.mark.parametrize("place", ["no/folder/a.npz", "file/a.npz"])
def test_where_nothing_can_be_written_a_sentence_says_so(tmp_path: Path, place: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RunFolderError, match=r"Cannot write .*a.npz: .*; choose another folder."):
        write_bytes(tmp_path / place, b"x")


def test_a_failed_write_leaves_the_old_content_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_bytes(tmp_path / "a", b"old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(archive.os, "fsync", full)
    with pytest.raises(RunFolderError, match="No space left"):
        write_bytes(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
