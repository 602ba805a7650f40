"""Files of plain arrays: written whole or not at all, and never executed when read.

What cannot be written or read raises RunFolderError, which says why.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import json
import math
import os
import stat
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from mcpilco.typing import RunFolderError

LARGEST = 2**29
"""most bytes that the arrays of one file may take in memory; a run writes some thousands"""
LARGEST_TEXT = 2**26
"""most bytes of a text that is read whole"""
_NO_FILES = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
_PLAIN = "biufcSU"
"""kinds of numpy's types that are read: numbers, truth values and text"""
_SUFFIX = ".tmp"


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A place to write a file, which then appears whole at `path`, also if the power fails.

    Where `path` is a link it stays one, and the file that it leads to is written.

    Raises:
        RunFolderError: the file cannot be written; what was there is there still.
    """
    target = destination(path)
    temporary = target.with_name(f".{target.name}.{os.getpid()}{_SUFFIX}")
    try:
        yield temporary
        _sync(temporary)
        temporary.replace(target)
        _sync(target.parent)
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        remedy = "make room on the disk" if full else "choose another folder"
        raise RunFolderError(
            f"Cannot write {path}: {error.strerror or error}; {remedy}."
        ) from error
    finally:
        with contextlib.suppress(OSError):  # it is gone where all went well
            temporary.unlink()


def destination(path: Path) -> Path:
    """The file that is written to at a path: where its links lead, which need not be there yet."""
    try:
        kind = _NO_FILES.get(stat.S_IFMT(path.stat().st_mode))
    except OSError as error:
        kind = "a link that leads in a circle" if error.errno == errno.ELOOP else None
    if kind is not None:
        raise RunFolderError(
            f"Cannot write {path}: it is {kind}, expected a regular file or a name that is free; "
            "name another file."
        )
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def make_folder(folder: Path, *names: str) -> None:
    """Make a folder to write into, where it is not there.

    All files of these names must land in it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunFolderError(
            f"{folder} cannot be written ({error.strerror or error}); choose another folder."
        ) from error
    if names:
        require_own(folder, *(folder / name for name in names))


def require_own(folder: Path, *paths: Path) -> None:
    """Make sure that what is written into a folder lands in it, whoever made the folder.

    Without `paths`, of all that is there.
    """
    root = Path(os.path.realpath(folder))
    for path in paths or sorted(folder.rglob("*")):
        end = Path(os.path.realpath(path))
        if not end.is_relative_to(root):
            raise RunFolderError(
                f"Cannot write into {folder}: {path} is a link to {end}, outside of the folder; "
                "put the file itself in its place."
            )
        if not path.is_dir():
            destination(path)


def leftovers(folder: Path) -> list[Path]:
    """Unfinished files of killed processes, in a folder and below it."""
    return [path for path in folder.rglob(f".*.[0-9]*{_SUFFIX}") if path.is_file()]


def _sync(path: Path) -> None:
    """Waits until a file or folder is on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_bytes(path: Path, content: bytes) -> Path:
    """Write a file so that a reader finds the old content or the new, never a part."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)
    return path


def finite(content: Any) -> Any:
    """A content with None in the place of numbers that are not finite, which JSON has not."""
    if isinstance(content, Mapping):
        return {key: finite(entry) for key, entry in content.items()}
    if isinstance(content, list | tuple):
        return [finite(entry) for entry in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def csv_bytes(names: Sequence[str], rows: Iterable[Iterable[object]]) -> bytes:
    """A CSV table with a header row, as the content of a file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    writer.writerows(rows)
    return text.getvalue().encode()


def read_text(path: Path) -> str:
    """The text of a file."""
    try:
        _check_kind(path)
        size = path.stat().st_size
        if size > LARGEST_TEXT:
            raise ValueError(f"{size} bytes, of at most {LARGEST_TEXT}")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise RunFolderError(f"{path} is missing; the run is not complete.") from error
    except OSError as error:
        raise RunFolderError(f"{path} cannot be read ({error.strerror or error}).") from error
    except ValueError as error:
        raise damaged(path, error) from error


def _check_kind(path: Path) -> None:
    """Raises ValueError for a device or a pipe, which would be read without an end."""
    if path.exists() and not path.is_file():
        raise ValueError("it is no file")


def damaged(path: Path, why: object) -> RunFolderError:
    """The error of a file whose content is damaged."""
    return RunFolderError(f"{path} is damaged ({why}); restore it from a copy, or train again.")


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> Path:
    """Write arrays by name as a compressed `.npz`, equal arrays to equal bytes.

    Raises:
        RunFolderError: the file cannot be written.
        ValueError: an array of objects.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, np.asarray(array), allow_pickle=False)
    return write_bytes(path, buffer.getvalue())


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an `.npz`, by name: numbers and text only, so nothing is executed.

    Nothing is unpacked to the disk, and what claims to take more than `LARGEST` is not unpacked.

    Raises:
        RunFolderError: the file is missing, damaged, or holds anything but plain arrays.
    """
    try:
        _check_kind(path)
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
            if size > LARGEST:
                raise ValueError(f"{size} bytes unpacked, of at most {LARGEST}")
            names = [_name_of(member.filename) for member in members]
            if len(set(names)) < len(names):
                raise ValueError("a name appears twice")
            return {
                name: _array(archive.read(member))
                for name, member in zip(names, members, strict=True)
            }
    except FileNotFoundError as error:
        raise RunFolderError(f"There is no file {path}; name one that exists.") from error
    except Exception as error:  # numpy and zipfile raise almost anything from damaged bytes
        raise RunFolderError(
            f"{path} is damaged or holds more than plain arrays: {error}"
        ) from error


def _name_of(member: str) -> str:
    """The name of the array in a member of the zip."""
    inside = PurePosixPath(member)
    strange = inside.is_absolute() or ".." in inside.parts or "\\" in member
    if strange or not member.endswith(".npy"):
        raise ValueError(f"no array: {member!r}")
    return member.removesuffix(".npy")


def _array(content: bytes) -> np.ndarray:
    """The array in a member, which holds as many bytes as its head says."""
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    heads = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    if version not in heads:
        raise ValueError(f"npy version {version}")
    shape, _, dtype = heads[version](stream)
    if dtype.kind not in _PLAIN:
        raise ValueError(f"type {dtype}")
    size, rest = math.prod(shape) * dtype.itemsize, len(content) - stream.tell()
    if size != rest or (size == 0 and math.prod(shape) > 0):
        raise ValueError(f"an array of shape {shape} and type {dtype} in {rest} bytes")
    stream.seek(0)
    return np.lib.format.read_array(stream, allow_pickle=False)


def write_groups(
    path: Path, about: Mapping[str, Any], groups: Mapping[str, Mapping[str, np.ndarray]]
) -> Path:
    """Write named groups of arrays, with a JSON object about them, as one `.npz`."""
    arrays = {"about": np.array(json.dumps(about))}
    for group, members in groups.items():
        arrays |= {f"{group}/{name}": array for name, array in members.items()}
    return write_arrays(path, arrays)


def read_groups(path: Path) -> tuple[dict[str, Any], dict[str, dict[str, np.ndarray]]]:
    """The content of a file of `write_groups`: the object, and the groups that are not empty."""
    arrays = read_arrays(path)
    try:
        about = json.loads(str(arrays.pop("about")))
        groups: dict[str, dict[str, np.ndarray]] = {}
        for path_inside, array in arrays.items():
            group, name = path_inside.split("/")
            groups.setdefault(group, {})[name] = array
        return dict(about), groups
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise RunFolderError(f"{path} does not say what its arrays are: {error!r}") from error
