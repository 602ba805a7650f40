"""The command line: `mcpilco train`, `evaluate`, `export`, `sweep`, `compare`, `view`, and others.

This package alone knows the envs of this project. A command imports what is slow (torch, rerun,
gymnasium) when it runs, so that `--help` answers at once.
"""

from __future__ import annotations

import functools
import operator
import os
import sys
from collections.abc import Sequence
from typing import Any

import tyro

from mcpilco.cli.collisions import Collisions
from mcpilco.cli.cross import Cross
from mcpilco.cli.doctor import CheckEnv, Doctor
from mcpilco.cli.finished import Evaluate, Export, Report
from mcpilco.cli.gap import Gap
from mcpilco.cli.identify import Identify
from mcpilco.cli.inverse_dynamics import InverseDynamics
from mcpilco.cli.kinematics import Kinematics
from mcpilco.cli.record import Record
from mcpilco.cli.sweep import Compare, Sweep
from mcpilco.cli.train import Demo, Train
from mcpilco.cli.view import View
from mcpilco.cli.volterra import Volterra
from mcpilco.typing import McPilcoError

__all__ = ["COMMANDS", "main"]

COMMANDS = (
    Demo,
    Train,
    Evaluate,
    Export,
    Sweep,
    Compare,
    Record,
    Gap,
    Cross,
    Identify,
    InverseDynamics,
    Kinematics,
    Collisions,
    Volterra,
    View,
    Report,
    CheckEnv,
    Doctor,
)
"""as `--help` lists them"""
_UNREAD = {"MPLBACKEND": "agg", "NUMBA_CACHE_DIR": "", "NUMBA_CACHE_LOCATOR_CLASSES": ""}
"""settings by which a file in the folder where the user is, which matplotlib and numba read, could
make them load code; an env variable of the user's own comes first"""
_ABOUT = "MC-PILCO: learn to control a system from seconds of experience."


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 2 wrong input, 130 interrupted.

    It is 141, without a word, where the reader of its output has left, as `| head` does.

    The arguments after `mcpilco` are by default those of this process.
    """
    try:
        code = _run(argv)
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for the flush at the end
        return 141


def _run(argv: Sequence[str] | None) -> int:
    _choose_gl()
    os.environ.update(_UNREAD | os.environ)
    kinds: Any = functools.reduce(operator.or_, COMMANDS)
    try:
        command = tyro.cli(
            kinds,
            prog="mcpilco",
            description=_ABOUT,
            args=None if argv is None else list(argv),
            config=(tyro.conf.FlagCreatePairsOff,),
        )
        return command()
    except SystemExit as stop:  # tyro has printed help, or what is wrong with the arguments
        return stop.code if isinstance(stop.code, int) else 2
    except McPilcoError as error:
        print(f"mcpilco: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as stop:  # with a sentence where a command says what is kept
        print(f"mcpilco: interrupted{f'; {stop}' if stop.args else '.'}", file=sys.stderr)
        return 130


def _choose_gl() -> None:
    """MuJoCo reads MUJOCO_GL when it is imported; without a display it must be told."""
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform == "linux" and not display:
        os.environ.setdefault("MUJOCO_GL", "egl")
