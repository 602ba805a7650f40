"""Jobs for other processes: light, so that a process starts fast."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def square(number: int) -> int:
    return number**2


def nothing() -> None:
    return None


def process() -> int:
    return os.getpid()


def fail() -> None:
    raise ValueError("no\nluck")


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def leave() -> None:
    os._exit(3)


def wait_for_ever() -> None:
    time.sleep(1e6)


def announce(path: Path) -> None:
    """Write the number of the process, and wait for ever."""
    path.with_suffix(".new").write_text(str(os.getpid()))
    path.with_suffix(".new").rename(path)
    wait_for_ever()
