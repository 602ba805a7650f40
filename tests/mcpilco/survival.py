"""Runs of the command line in processes that can be killed, and when two runs are equal.

The processes are forked from a server that has imported all that is slow.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch._dynamo
import torch._refs  # noqa: F401  loaded once, for all

import mcpilco.agent.agent
import mcpilco.agent.stored
import mcpilco.show.recorder
import mcpilco.show.recording  # noqa: F401  loaded once, for all
from mcpilco.cli import main
from mcpilco.config import PRESETS
from mcpilco.logbook import RunFolder
from mcpilco.show.viewer import _executable
from tests.mcpilco.point import STEPS, TINY, PointEnv

ENV = "Survival/Point-v0"
TRIALS = 3
TIMES = {"wall_s", "cpu_s", "time/wall_s", "time/cpu_s"}
"""all that may differ between equal runs, but for the ids that Rerun gives"""

if ENV not in gym.registry:
    gym.register(ENV, PointEnv, max_episode_steps=STEPS)

_context = get_context("forkserver")
_context.set_forkserver_preload([__name__])


def train(path: Path, trials: int = TRIALS) -> list[str]:
    """Arguments that begin a run."""
    where = ["--env", ENV, "--seed", "5", "--out", str(path)]
    return ["train", *where, "--trials", str(trials), "--quiet"]


def resume(path: Path) -> list[str]:
    """Arguments that go on with it."""
    return ["train", "--resume", str(path), "--quiet"]


def command(argv: list[str], sabotage: Callable[[], None] | None = None) -> Any:
    """A process that runs `mcpilco argv` with a small agent; it is started, and not waited for."""
    return process(_run, argv, sabotage)


def process(target: Callable[..., None], *arguments: Any) -> Any:
    """A process that calls a function; it is started, and not waited for."""
    started = _context.Process(target=target, args=arguments)
    started.start()
    return started


def exit_code(argv: list[str], sabotage: Callable[[], None] | None = None) -> int:
    """How `mcpilco argv` ends; a process that does not is killed after a minute."""
    run = command(argv, sabotage)
    run.join(60)
    if run.is_alive():
        run.kill()
    run.join()
    return run.exitcode


def _run(argv: list[str], sabotage: Callable[[], None] | None) -> None:
    PRESETS["default"] = dataclasses.replace(PRESETS["default"], config=TINY)
    if sabotage is not None:
        sabotage()
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        sys.exit(main(argv))


@dataclasses.dataclass(frozen=True)
class KilledAtWrite:
    """Kills the process when it puts its n-th file in place: just before, or just after."""

    number: int
    after: bool

    def __call__(self) -> None:
        replace, count = os.replace, iter(range(1, self.number + 1))

        def fatal(*paths: Any) -> None:
            last = next(count) == self.number
            if not last or self.after:
                replace(*paths)
            if last:
                os.kill(os.getpid(), signal.SIGKILL)

        os.replace = fatal


def content(path: Path) -> dict[str, Any]:
    """What the files of a run say, by name, without times; of recordings only that they exist."""
    files = sorted(file for file in path.rglob("*") if file.is_file())
    return {file.relative_to(path).as_posix(): _said(file) for file in files}


def _said(file: Path) -> Any:
    if file.name == "metrics.csv":
        return [_timeless(row) for row in RunFolder.open(file.parent).metrics()]
    if file.suffix == ".jsonl":
        return [_timeless(json.loads(line)) for line in file.read_text().splitlines()]
    if file.suffix == ".json":
        return _timeless(json.loads(file.read_text()))
    return None if file.suffix == ".rrd" else file.read_bytes()


def _timeless(values: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key not in TIMES}


def equal_recordings(first: Path, second: Path) -> bool:
    """Whether Rerun calls all recordings of two runs equal."""
    names = [file.name for file in (first / "rollouts").iterdir()]
    pairs = [(first / "rollouts" / name, second / "rollouts" / name) for name in names]
    return all(
        subprocess.run([_executable(), "rrd", "compare", *pair], capture_output=True).returncode
        == 0
        for pair in pairs
    )
