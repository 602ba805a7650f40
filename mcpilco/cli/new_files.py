"""Files that a command is about to write: nothing is overwritten."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mcpilco.typing import RecordingError


def make_folder(folder: Path, paths: Iterable[Path], remedy: str) -> None:
    """Make a folder for new files.

    Args:
        folder: to make, where it is not there.
        paths: of the files, which must not be there.
        remedy: what to do where one is.

    Raises:
        RecordingError: the folder cannot be made, or a file is there already.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordingError(
            f"{folder} cannot be made ({error.strerror or error}); choose another folder."
        ) from error
    for path in paths:
        require_new(path, remedy)


def require_new(path: Path, remedy: str) -> None:
    """Raises RecordingError where a file is there already; `remedy` says what to do then."""
    if path.exists():
        raise RecordingError(f"{path} exists already; nothing is overwritten: {remedy}.")
