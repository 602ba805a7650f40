"""`mcpilco doctor` and `check-env`: do machine and env suit, and what to do where they do not."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from platform import machine, platform, python_version
from typing import Annotated

import tyro

from mcpilco.cli import options

_NEEDED = (
    "torch",
    "numpy",
    "scipy",
    "gymnasium",
    "mujoco",
    "rerun-sdk",
    "numba",
    "tyro",
    "rich",
    "jaxtyping",
)
_OPTIONAL = {
    "stable-baselines3": "mcpilco train --algo sac, tqc or ppo",
    "sb3-contrib": "mcpilco train --algo sac, tqc or ppo",
    "tensorboard": "mcpilco train --tensorboard",
    "matplotlib": "mcpilco report and demo",
    "jinja2": "mcpilco report, and export --c",
    "onnx": "mcpilco export --onnx",
    "imageio-ffmpeg": "mcpilco view --video FILE.mp4",
}
_MARKS = {"fits": "ok", "note": "--", "fault": "no"}
_LEAST_FREE_GB = 1.0  # a run of ten trials takes about 10 MB; caches of compiled loops take more
_PATIENCE_S = 60.0


@dataclass(frozen=True)
class Finding:
    """One thing looked at."""

    subject: str
    found: str
    fix: str = ""
    """what to do; empty where all is well"""
    needed: bool = True
    """False: mcpilco works without, but for what `fix` says"""


@dataclass(frozen=True)
class Doctor(options.Command):
    """Check this machine, and say what to do where something is missing."""

    def __call__(self) -> int:
        """Print the findings; returns 0 when mcpilco can work, else 1."""
        from rich.box import SIMPLE_HEAD
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        findings = list(examine())
        table = Table("", "what", "found", "to do", box=SIMPLE_HEAD)
        for finding in findings:
            mark = "ok" if not finding.fix else "no" if finding.needed else "--"
            cells = (mark, finding.subject, finding.found, finding.fix)
            table.add_row(*(Text(cell, overflow="fold") for cell in cells))
        Console().print(table)
        missing = [finding.subject for finding in findings if finding.fix and finding.needed]
        print(f"To mend: {', '.join(missing)}." if missing else "All that is needed is here.")
        return 1 if missing else 0


def examine() -> Iterator[Finding]:
    """Everything that is looked at, in the order in which it fails most often."""
    fix = "" if sys.version_info >= (3, 11) else "install Python 3.11 or later"
    yield Finding("Python", f"{python_version()} on {platform(terse=True)}, {machine()}", fix)
    yield from _packages()
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count()
    about = f"{cores} cores; each command computes on one, run seeds side by side"
    yield Finding("processor", about)
    yield _environment()
    yield _compiler()
    yield _gl()
    yield _viewer()
    yield _window()
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    fix = "" if free >= _LEAST_FREE_GB else f"free at least {_LEAST_FREE_GB:g} GB"
    yield Finding("disk", f"{free:.1f} GB free in {Path.cwd()}", fix)
    yield _writes()


def _packages() -> Iterator[Finding]:
    for package in _NEEDED:
        version = _version(package)
        yield Finding(package, version or "missing", "" if version else f"pip install {package}")
    for package, purpose in _OPTIONAL.items():
        version = _version(package)
        fix = "" if version else f"for {purpose}: pip install {package}"
        yield Finding(package, version or "not installed", fix, needed=False)


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _environment() -> Finding:
    """Can the cart-pole be made and stepped?"""
    code = (
        "import envs, gymnasium as gym; e = gym.make('mcpilco/CartPoleSwingUp-v0');"
        "e.reset(seed=0); e.step(e.action_space.sample()); print(e.spec.id)"
    )
    ok, said = _says([sys.executable, "-c", code])
    return Finding("env", said, "" if ok else "install mcpilco again: pip install .")


def _compiler() -> Finding:
    """Does numba compile a loop here?"""
    code = "import numba; print(numba.njit(lambda x: x + 1)(1) == 2)"
    ok, said = _says([sys.executable, "-c", code])
    fix = "" if ok and said == "True" else "pip install --force-reinstall numba"
    return Finding("numba compiles", "yes" if not fix else said, fix)


def _gl() -> Finding:
    """Can MuJoCo draw? It may take down its process, so ask another one."""
    code = (
        "import envs, gymnasium as gym; e = gym.make('mcpilco/MujocoCartPoleSwingUp-v0',"
        "render_mode='rgb_array'); e.reset(seed=0); e.render(); print('works')"
    )
    ok, said = _says([sys.executable, "-c", code])
    fix = "for pictures of MuJoCo envs: apt-get install libegl1 libgl1-mesa-dri"
    return Finding("MuJoCo draws", said, "" if ok else fix, needed=False)


def _viewer() -> Finding:
    spec = find_spec("rerun_cli")
    name = "rerun.exe" if os.name == "nt" else "rerun"
    folders = spec.submodule_search_locations or [] if spec else []
    binary = next((Path(f) / name for f in folders if (Path(f) / name).is_file()), None)
    ok, said = (False, "missing") if binary is None else _says([str(binary), "--version"])
    fix = "" if ok else "pip install --force-reinstall rerun-sdk"
    return Finding("Rerun viewer", "starts" if ok else said, fix)


def _window() -> Finding:
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if display or sys.platform in ("win32", "darwin"):
        return Finding("display", display or "the desktop", needed=False)
    return Finding("display", "none", "use mcpilco view --web or --screenshot", needed=False)


def _writes() -> Finding:
    """May a run folder be made in the present folder?"""
    try:
        with tempfile.TemporaryDirectory(dir=Path.cwd()):
            return Finding("run folders", "can be written here")
    except OSError as error:
        fix = "change to a folder that you may write to, or pass --out"
        return Finding("run folders", error.strerror or str(error), fix)


def _says(command: list[str]) -> tuple[bool, str]:
    """Does a command succeed, and the last line that it writes."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_PATIENCE_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return False, str(error)
    text = done.stdout if done.returncode == 0 else done.stderr or done.stdout
    lines = text.strip().splitlines() or [f"exit code {done.returncode}"]
    return done.returncode == 0, lines[-1]


@dataclass(frozen=True)
class CheckEnv(options.Command):
    """Say what of an env fits the agent and what does not; takes some hundred random steps."""

    env: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="ID")]
    """Gymnasium id of the env; `module:Id` imports the module first"""
    task: options.TaskPath = None
    """what to know of the env, where it does not show it"""
    horizon: Annotated[int | None, options.optional("INT", "the env's time limit")] = None
    """steps of a rollout"""
    steps: int = 400
    """random steps to judge it by"""
    seed: int = 0
    """of the env and the inputs"""

    def __call__(self) -> int:
        """Print the findings; returns 0 where the agent can use the env, else 1."""
        options.require_at_least(1, horizon=self.horizon, steps=self.steps)
        options.require_at_least(0, seed=self.seed)
        options.use_one_thread()
        options.register(self.env)

        from mcpilco.agent import inspect_env, make_env

        faults = 0
        with contextlib.closing(make_env(self.env)) as env:
            task = options.given_task(self.task)
            found = inspect_env(env, task, horizon=self.horizon, steps=self.steps, seed=self.seed)
            for finding in found:
                print(f"{_MARKS[finding.kind]}  {finding.sentence}")
                faults += finding.kind == "fault"
        print(f"To mend: {faults}." if faults else "The agent can use this env.")
        return 1 if faults else 0
