"""The rig of runs/rig, started and ended."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

RIG = Path(__file__).parents[2] / "runs" / "rig" / "rig.py"


class Rig:
    """The rig as a process of its own, at a port that was free."""

    def __init__(self, *options: str, port: int = 0) -> None:
        command = [sys.executable, str(RIG), "--port", str(port), "--control", *options]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        self.address = self.process.stdout.readline().split()[3].rstrip(";")

    def tell(self, fault: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(fault + "\n")
        self.process.stdin.flush()

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


@contextlib.contextmanager
def rig(*options: str, port: int = 0) -> Iterator[Rig]:
    made = Rig(*options, port=port)
    try:
        yield made
    finally:
        made.kill()
