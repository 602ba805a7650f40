"""A task that its user wrote into a file: Python, TOML or JSON."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from mcpilco.task import TaskSpec
from mcpilco.typing import Cost, InputError

NAMES = ("TASK", "task")
"""what a task may be called in a Python file"""


def load_task(path: str | Path) -> TaskSpec:
    """The task in a file that its user named.

    A Python file is executed, and so is the module that the `cost` of a TOML or JSON file names:
    call this with files of the user's own, never with one that a run folder names.

    Args:
        path: of Python that defines `TASK`, or of TOML or JSON with the entries of a `TaskSpec`,
            where `cost` is `"module:function"` or `"file.py:function"`, or absent, for one that is
            learned from the rewards.

    Raises:
        InputError: there is no such file, or it holds no task.
    """
    path = Path(path)
    readers = {".py": _from_python, ".toml": _from_entries, ".json": _from_entries}
    if path.suffix not in readers:
        raise InputError(f"A task file must end in .py, .toml or .json, got {path}.")
    if not path.is_file():
        raise InputError(f"There is no task file {path}.")
    return readers[path.suffix](path)


def _from_python(path: Path) -> TaskSpec:
    module = _execute(path)
    found = [getattr(module, name) for name in NAMES if hasattr(module, name)]
    if not found or not isinstance(found[0], TaskSpec):
        got = f"{NAMES[0]} of type {type(found[0]).__name__}" if found else "none"
        raise InputError(f"{path} must define {NAMES[0]}, a mcpilco.TaskSpec, got {got}.")
    return found[0]


def _from_entries(path: Path) -> TaskSpec:
    entries = task_entries(path)
    named = entries.pop("cost", None)
    cost = None if named is None else _cost(named, path)
    try:
        return TaskSpec.from_json(entries, cost)
    except (TypeError, InputError) as error:
        why = str(error).rstrip(".")
        raise InputError(f"{path} holds no task: {why}; see the entries of TaskSpec.") from error


def task_entries(path: Path) -> dict[str, Any]:
    """The entries of a TOML or JSON file.

    Raises:
        InputError: it cannot be read, or holds no entries.
    """
    try:
        text = path.read_text(encoding="utf-8")
        entries = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
    except (OSError, ValueError) as error:  # both decoders raise kinds of ValueError
        raise InputError(f"{path} cannot be read: {error}.") from error
    if not isinstance(entries, Mapping):
        raise InputError(f"{path} must hold entries by name, got {entries!r}.")
    return dict(entries)


def _cost(named: Any, path: Path) -> Cost:
    """The function that a file names; a relative file lies beside it."""
    where, _, name = named.rpartition(":") if isinstance(named, str) else ("", "", "")
    if not where or not name:
        raise InputError(
            f'{path}: cost must be like "module:function" or "file.py:function", got {named!r}.'
        )
    module = _execute(path.parent / where) if where.endswith(".py") else _import(where)
    cost = getattr(module, name, None)
    if not callable(cost):
        raise InputError(f"{path}: {where} has no function {name!r} for the cost.")
    return cost


def _execute(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"_task_file_{path.stem}", path)
    assert spec is not None, "its name ends in .py"
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the user's file may raise
        raise InputError(f"{path} cannot be executed ({type(error).__name__}: {error}).") from error
    return module


def _import(name: str) -> ModuleType:
    here = os.getcwd()
    if here not in sys.path:  # the module may lie where the user is, as with `python -m`
        sys.path.append(here)
    try:
        return importlib.import_module(name)
    except Exception as error:
        raise InputError(f"Cannot import {name} for the cost ({error}).") from error
