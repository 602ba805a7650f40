"""The first steps of several commands: one thread, envs and algorithms, folders for new files."""

from __future__ import annotations

import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path

from mcpilco.typing import InputError, RecordingError


class Command(ABC):
    """A command and its options, which are its fields."""

    @abstractmethod
    def __call__(self) -> int:
        """Run it, and return the exit code.

        Raises:
            McPilcoError: a wrong input; the sentence says which.
        """


def use_one_thread() -> None:
    """Keep torch and BLAS to one thread: the matrices are small, and runs share a machine.

    It also makes results equal to the last digit, wherever the command runs.
    """
    import scipy.linalg  # noqa: F401  loads the BLAS whose threads are limited
    import torch
    from threadpoolctl import threadpool_limits

    torch.set_num_threads(1)
    threadpool_limits(1)


def register() -> None:
    """Register the envs and algorithms of this project, and let modules here be imported.

    An env's module may lie where the user is, as with `python -m`.
    """
    import baselines  # noqa: F401  registers its algorithms
    import envs  # noqa: F401  registers its ids

    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)


def require_at_least(least: int, **values: int | None) -> None:
    """Check options that are whole numbers, by name; None is an option that is not given.

    Raises:
        InputError: one is less.
    """
    for name, value in values.items():
        if value is not None and value < least:
            expected = "not be negative" if least == 0 else f"be at least {least}"
            raise InputError(f"--{name} must {expected}, got {value}.")


def make_folder(folder: Path, paths: Iterable[Path] = (), remedy: str = "") -> None:
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
