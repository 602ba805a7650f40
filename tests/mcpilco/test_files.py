"""Laws of files: whole or not at all, equal content to equal bytes, nothing executed."""

from __future__ import annotations

import contextlib
import io
import os
import pickle
import socket
import stat
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from mcpilco import files as archive
from mcpilco.files import (
    finite,
    leftovers,
    make_folder,
    read_arrays,
    read_groups,
    read_text,
    replacing,
    require_own,
    write_arrays,
    write_bytes,
    write_groups,
)
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


@pytest.mark.slow
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


def zipped(**members: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return buffer.getvalue()


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


@pytest.mark.parametrize("name", ["../x.npy", "a/../../x.npy", "/x.npy", "..\\x.npy", "x.py"])
def test_a_member_that_is_no_array_of_the_file_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / "folder" / "a.npz"
    path.parent.mkdir()
    path.write_bytes(zipped(**{name: npy(np.ones(3))}))
    with pytest.raises(RunFolderError, match="more than plain arrays: no array"):
        read_arrays(path)
    assert list(tmp_path.rglob("*")) == [path.parent, path]


def test_a_name_that_appears_twice_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        file.writestr("x.npy", npy(np.ones(3)))
        with pytest.warns(UserWarning, match="Duplicate name"):
            file.writestr("x.npy", npy(np.ones(3)))
    with pytest.raises(RunFolderError, match="twice"):
        read_arrays(tmp_path / "a.npz")


def test_what_would_take_too_much_memory_is_not_unpacked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(archive, "LARGEST", 5000)
    path = tmp_path / "a.npz"
    path.write_bytes(zipped(**{"x.npy": npy(np.zeros(300)), "y.npy": npy(np.zeros(300))}))
    with pytest.raises(RunFolderError, match="5056 bytes unpacked, of at most 5000"):
        read_arrays(path)
    path.write_bytes(zipped(**{"x.npy": npy(np.zeros(300))}))
    assert len(read_arrays(path)["x"]) == 300


@pytest.mark.parametrize("shape", [(10**12,), (2**31, 2**31, 2**31), (9,), (7,), (-8,)])
def test_an_array_that_claims_another_size_is_refused(tmp_path: Path, shape: tuple) -> None:
    """Before room is made for it."""
    content = npy(np.zeros(8))
    longer = content.replace(b"(8,), }", f"{shape}, }}".encode())
    head = longer[:10] + longer[10:-64].rstrip(b" \n").ljust(117) + b"\n" + bytes(64)
    path = tmp_path / "a.npz"
    path.write_bytes(zipped(**{"x.npy": head}))
    with pytest.raises(RunFolderError, match="plain arrays"):
        read_arrays(path)


def test_records_are_no_plain_arrays(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(zipped(**{"x.npy": npy(np.zeros(2, [("a", float)]))}))
    with pytest.raises(RunFolderError, match="type"):
        read_arrays(path)


@pytest.mark.parametrize("read", [read_arrays, read_text])
def test_a_device_is_not_read(tmp_path: Path, read) -> None:
    """It would have no end."""
    (tmp_path / "a").symlink_to("/dev/zero")
    with pytest.raises(RunFolderError, match="it is no file"):
        read(tmp_path / "a")


def test_a_text_that_is_too_long_is_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(archive, "LARGEST_TEXT", 10)
    (tmp_path / "a").write_text("x" * 11)
    with pytest.raises(RunFolderError, match="11 bytes, of at most 10"):
        read_text(tmp_path / "a")


def test_what_a_killed_writer_leaves_is_known(tmp_path: Path) -> None:
    path = write_bytes(tmp_path / "a", b"old")
    mine = tmp_path / ".mine.tmp"
    mine.touch()
    with contextlib.suppress(KeyboardInterrupt), replacing(path) as temporary:
        temporary.write_bytes(b"ne")
        assert leftovers(tmp_path) == [temporary]
        raise KeyboardInterrupt
    assert path.read_bytes() == b"old"
    assert leftovers(tmp_path) == []
    assert mine.exists()


def test_a_link_stays_a_link_and_its_target_is_written(tmp_path: Path) -> None:
    """Also a link to a link, in another folder, and one to a file that is not there yet."""
    (tmp_path / "far").mkdir()
    target, link, first = tmp_path / "far" / "file", tmp_path / "link", tmp_path / "first"
    link.symlink_to("far/file")
    first.symlink_to(link)
    for content in (b"new", b"other"):
        assert write_bytes(first, content) == first
        assert target.read_bytes() == content
        assert link.is_symlink()
        assert first.is_symlink()
    assert not leftovers(tmp_path)


def test_a_link_keeps_its_target_where_the_writing_fails(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"old")
    (tmp_path / "link").symlink_to("file")
    with contextlib.suppress(ZeroDivisionError), replacing(tmp_path / "link") as place:
        place.write_bytes(b"half")
        raise ZeroDivisionError
    assert (tmp_path / "file").read_bytes() == b"old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "link"]


def special_files(folder: Path) -> dict[str, Path]:
    """Whatever is not a regular file, by the name that messages give it."""
    found = {kind: folder / kind for kind in ("pipe", "socket", "folder", "device")}
    os.mkfifo(found["pipe"])
    here = os.getcwd()
    os.chdir(folder)  # the path of a socket must be short
    try:
        with socket.socket(socket.AF_UNIX) as server:
            server.bind("socket")
    finally:
        os.chdir(here)
    found["folder"].mkdir()
    try:
        os.mknod(found["device"], stat.S_IFCHR | 0o600, os.makedev(1, 3))
    except PermissionError:  # it takes root
        del found["device"]
    return found


def test_what_is_no_file_is_refused_and_stays(tmp_path: Path) -> None:
    for kind, path in special_files(tmp_path).items():
        before = path.stat().st_mode
        link = tmp_path / f"to-{kind}"
        link.symlink_to(path)
        for named in (path, link):
            with pytest.raises(RunFolderError, match=f"{named}: it is a {kind}, .*name another"):
                write_bytes(named, b"new")
        assert path.stat().st_mode == before
        assert link.is_symlink()


def test_links_in_a_circle_are_refused(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("link")
    with pytest.raises(RunFolderError, match="leads in a circle"):
        write_bytes(tmp_path / "link", b"new")


def test_what_is_written_into_a_folder_lands_in_it(tmp_path: Path) -> None:
    """Links under other names than those of the files to be written are the user's own."""
    folder = tmp_path / "new" / "folder"
    make_folder(folder, "table.csv", "picture.png")
    (folder / "data").symlink_to(tmp_path)
    make_folder(folder, "table.csv", "picture.png")
    (folder / "picture.png").symlink_to(tmp_path / "secret")
    with pytest.raises(RunFolderError, match=r"picture\.png is a link to .*secret, outside"):
        make_folder(folder, "table.csv", "picture.png")
    (tmp_path / "file").touch()
    with pytest.raises(RunFolderError, match="cannot be written"):
        make_folder(tmp_path / "file")


def test_no_command_makes_a_folder_otherwise() -> None:
    """So that none forgets to ask where its files land."""
    sources = (Path(archive.__file__).parent / "cli").glob("*.py")
    assert not [path.name for path in sources if ".mkdir(" in path.read_text(encoding="utf-8")]


def test_a_folder_that_leads_outside_is_not_written_to(tmp_path: Path) -> None:
    """Links within it are well; `require_own` asks before a folder of somebody else is used."""
    folder = tmp_path / "folder"
    (folder / "inner").mkdir(parents=True)
    (folder / "inner" / "link").symlink_to("../file")
    require_own(folder)
    (folder / "inner" / "out").symlink_to(tmp_path / "secret")
    with pytest.raises(RunFolderError, match="inner/out is a link to .*secret, outside"):
        require_own(folder)
    (folder / "inner" / "out").unlink()
    os.mkfifo(folder / "inner" / "pipe")
    with pytest.raises(RunFolderError, match="it is a pipe"):
        require_own(folder)


def test_what_is_not_finite_is_none_wherever_it_stands() -> None:
    content = {"a": [1.0, np.nan, (np.inf, 2)], "b": {"c": -np.inf, "d": "nan"}, "e": True}
    assert finite(content) == {"a": [1.0, None, [None, 2]], "b": {"c": None, "d": "nan"}, "e": True}
