"""Jobs for other processes: light, so that a process starts fast."""

from __future__ import annotations

import os
import signal
import time


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
