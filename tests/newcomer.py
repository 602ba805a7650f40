"""A newcomer: follows a page of the documentation word by word, in an empty folder.

Each command is a process of its own, and the Python blocks without a title are one session, as in
a terminal. The processes see what is installed and the folder, and nothing else of the clone. They
are forked from a server that has imported all that is slow.
"""

from __future__ import annotations

import contextlib
import dataclasses
import glob
import os
import re
import runpy
import shlex
import sys
import traceback
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import baselines.evaluate  # noqa: F401  loaded once, for all
import envs.arms  # noqa: F401
import mcpilco.gap
import mcpilco.identification  # noqa: F401
from baselines import pilco
from baselines.pilco import PilcoConfig
from baselines.sb3 import PPOAgent, SACAgent, TQCAgent, WarmStart, from_model
from mcpilco.cli import main
from mcpilco.config import PRESETS, Config, Phase, PolicyConfig, SearchConfig
from tests.baselines.sb3.small import TINY
from tests.mcpilco import survival

ROOT = Path(__file__).parent.parent

SMALL = Config(
    policy=PolicyConfig(bases=4),
    search=SearchConfig(
        particles=4,
        steps=(2,),
        phases=(Phase(0.01),),
        restarts=(0,),
        evaluation_particles=4,
    ),
    engine="eager",  # nothing to compile
)
SMALL_PILCO = PilcoConfig(centres=3, line_searches=1, evaluations=3)

QUICKER = {
    r"^make train$": "mcpilco train --out RUN",  # what the target does, in a folder with that name
    r"^make train SEED=(\S+) TRIALS=\S+ OUT=": r"mcpilco train --trials 1 --seed \1 --out ",
    r"(sweep .*)--seeds \S+": r"\1--seeds 0:1 --trials 1 --fresh 2",
    r"^mcpilco cross ": "mcpilco cross --seconds 18 --rollouts 3 --trials 1 --episodes 2 ",
    r"^mcpilco train (?!.*--(trials|resume))": "mcpilco train --trials 2 ",
    r"--episodes \d+": "--episodes 2",
    r"^mcpilco evaluate (?!.*--episodes)": "mcpilco evaluate --episodes 2 ",
}
"""All that is changed in a command before it is run, beside the presets: patterns, replacements"""

NOT_RUN = {
    r"^(git|cd|source|pip) |^make (test|check|format|docs|stale)": "needs a clone, or PyPI",
    r"--machine ": "needs a machine",
    r"^mcpilco gap crossing/machine": "needs its recordings",
    r"(^|/)python runs/": "measures for minutes or hours, in a clone",
    r"^chromium |^python -c .*PIL": "needs a browser, and reduces its pictures",
    r"^mcpilco view |--live": "needs a screen or a graphics driver",
    r"^mcpilco doctor": "judges the machine, by how fast it answers too",
    r"^ray |--engine ray": "needs a cluster",
    r"\b(FIRST|LOG|MODULE|POSES)\b": "words in capitals are the reader's own files",
}
"""Commands that are parsed only, and why"""

EXIT_CODES = {r"CartPole-v9": 2}
"""of commands that shall fail"""

PROGRAMS = ("mcpilco", "python", ".venv/bin/python", "git", "cd", "source", "make", "pip")
PROGRAMS += ("chromium", "ray", "RAY_ADDRESS=HEAD:6379")
_BLOCK = re.compile(
    r'^```(?P<language>\w*)(?: title="(?P<title>.*?)")?\n(?P<body>.*?)^```$'
    r"|(?P<indented>(?:^ {4}[^\n]*\n)+)",
    re.MULTILINE | re.DOTALL,
)


class Step(NamedTuple):
    """A command or block of a page, at its line."""

    line: int
    kind: str
    """`command`, `file` (a block with a title) or `session` (Python without one)"""
    text: str
    title: str = ""


def steps(page: Path) -> Iterator[Step]:
    """The steps of a page, from top to bottom."""
    text = page.read_text(encoding="utf-8")
    for block in _BLOCK.finditer(text):
        line = text.count("\n", 0, block.start()) + 1
        if block["indented"]:
            for command in block["indented"].replace("\\\n", " ").splitlines():
                words = command.partition(" #")[0].split()
                if words and words[0] in PROGRAMS:
                    yield Step(line, "command", " ".join(words))
        elif block["title"]:
            yield Step(line, "file", block["body"], block["title"])
        elif block["language"] == "python":
            yield Step(line, "session", block["body"])


def not_run(command: str) -> str | None:
    """Why a command is parsed only."""
    return next((why for pattern, why in NOT_RUN.items() if re.search(pattern, command)), None)


def quicker(command: str) -> str:
    """The command with smaller numbers."""
    for pattern, replacement in QUICKER.items():
        command = re.sub(pattern, replacement, command)
    return command


def follow(page: Path, home: Path) -> None:
    """Do all that a page says; an `AssertionError` names the line where it cannot be done.

    Args:
        page: of the documentation.
        home: an empty folder, for the folder of the newcomer, for the installed packages, and for
            what the present command prints.
    """
    folder, output, session = home / "folder", home / "output", None
    (home / "site").mkdir()
    for name in ("mcpilco", "envs", "baselines"):
        (home / "site" / name).symlink_to(ROOT / name)
    folder.mkdir()
    try:
        for step in steps(page):
            where = f"{page.name}:{step.line}: {step.title or step.text}"
            if step.kind == "file":
                (folder / step.title).write_text(step.text, encoding="utf-8")
            elif step.kind == "session":
                session = session or Session(folder, output)
                assert session.answers(step), f"{where}\n{output.read_text()}"
            elif not_run(step.text) is None:
                process = survival.process(_alone, _command, folder, output, quicker(step.text))
                process.join()
                expected = next((n for p, n in EXIT_CODES.items() if re.search(p, step.text)), 0)
                assert process.exitcode == expected, f"{where}\n{output.read_text()}"
    finally:
        if session is not None:
            session.end()


class Session:
    """A Python session in a process of its own, in which blocks share their names."""

    def __init__(self, folder: Path, output: Path) -> None:
        self._pipe, other = _context.Pipe()
        self._process = survival.process(_alone, _session, folder, output, other)
        other.close()

    def answers(self, step: Step) -> bool:
        """Run a block; whether it ended without an exception."""
        self._pipe.send(step.text)
        try:
            return self._pipe.recv()
        except EOFError:
            return False

    def end(self) -> None:
        """Leave the session, unless it has ended by an exception."""
        with contextlib.suppress(BrokenPipeError):
            self._pipe.send(None)
        self._process.join()


# --- in the processes -----------------------------------------------------------------------------

_context = get_context("forkserver")
_context.set_forkserver_preload([survival.__name__, __name__])


def _alone(target: Callable[[Any], int], folder: Path, output: Path, what: Any) -> None:
    """Call a function in the folder, with small presets and without the clone; exit by its code."""
    os.chdir(folder)
    with (
        open(output, "w", encoding="utf-8", buffering=1) as file,
        contextlib.redirect_stdout(file),
        contextlib.redirect_stderr(file),
    ):
        _leave_the_clone(folder.parent / "site")
        _use_small_presets()
        try:
            code = target(what)
        except BaseException:
            code = 1
            traceback.print_exc()
    sys.exit(code)


def _command(line: str) -> int:
    program, *words = shlex.split(line)
    arguments = [name for word in words for name in (sorted(glob.glob(word)) or [word])]
    if program == "mcpilco":
        return main(arguments)
    sys.argv, sys.path[:0] = arguments, [""]
    runpy.run_path(arguments[0], run_name="__main__")
    return 0


def _session(pipe: Connection) -> int:
    sys.path.insert(0, "")
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in iter(pipe.recv, None):
        exec(compile(block, "<the page>", "exec"), names)
        pipe.send(True)
    return 0


def _leave_the_clone(site: Path) -> None:
    """Import the packages from a folder that holds nothing else, here and in further processes."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "tests"]:
        del sys.modules[name]
    sys.path[:] = [str(site), *(path for path in sys.path if path and not _is_clone(Path(path)))]
    os.environ["PYTHONPATH"] = str(site)


def _is_clone(path: Path) -> bool:
    return (path / "tests" / "conftest.py").exists()


def _use_small_presets() -> None:
    """Let the presets learn nothing in no time."""
    for name, preset in PRESETS.items():
        PRESETS[name] = dataclasses.replace(preset, config=SMALL)
    for name, preset in pilco.PRESETS.items():
        config = dataclasses.replace(SMALL_PILCO, cost=preset.config.cost)
        pilco.PRESETS[name] = dataclasses.replace(preset, config=config)
    for kind in (SACAgent, TQCAgent, PPOAgent):
        default = kind.presets["default"]
        kind.presets["default"] = dataclasses.replace(default, config=TINY[kind.algo], by_env={})
    from_model.DEFAULT = WarmStart(2, first_steps=1, rounds=0)
