"""Files of plain arrays: written whole or not at all, and never executed when read."""

from __future__ import annotations

import contextlib
import io
import json
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mcpilco.typing import RunFolderError


def write_bytes(path: Path, content: bytes) -> Path:
    """Write a file so that a reader finds the old content or the new, never a part.

    Raises:
        RunFolderError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise RunFolderError(
            f"Cannot write {path}: {error.strerror or error}; choose another folder."
        ) from error
    finally:
        with contextlib.suppress(OSError):  # it is gone where all went well
            temporary.unlink()
    return path


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
    """All arrays of an `.npz`, by name; object arrays are refused, so nothing is executed.

    Raises:
        RunFolderError: the file is missing, damaged, or holds anything but plain arrays.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        strangers = [name for name, array in arrays.items() if not isinstance(array, np.ndarray)]
        if strangers:
            raise ValueError(f"no arrays: {', '.join(strangers)}")
        return arrays
    except FileNotFoundError as error:
        raise RunFolderError(f"There is no file {path}.") from error
    except Exception as error:  # numpy and zipfile raise almost anything from damaged bytes
        raise RunFolderError(
            f"{path} is damaged or holds more than plain arrays: {error}"
        ) from error


def write_groups(
    path: Path, about: Mapping[str, Any], groups: Mapping[str, Mapping[str, np.ndarray]]
) -> Path:
    """Write named groups of arrays, with a JSON object about them, as one `.npz`.

    Raises:
        RunFolderError: the file cannot be written.
    """
    arrays = {"about": np.array(json.dumps(about))}
    for group, members in groups.items():
        arrays |= {f"{group}/{name}": array for name, array in members.items()}
    return write_arrays(path, arrays)


def read_groups(path: Path) -> tuple[dict[str, Any], dict[str, dict[str, np.ndarray]]]:
    """What `write_groups` wrote: the object, and the groups that are not empty.

    Raises:
        RunFolderError: the file is missing, damaged, or was written otherwise.
    """
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
