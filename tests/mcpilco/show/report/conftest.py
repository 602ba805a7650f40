"""A short run of the real agent, small enough to learn nothing in no time."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import pytest

import mcpilco.cli
from mcpilco.config import PRESETS
from mcpilco.logbook import History, RunFolder, read_history
from tests.newcomer import SMALL


@pytest.fixture(scope="session")
def made_once(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("report") / "run"
    with pytest.MonkeyPatch.context() as patch:
        preset = dataclasses.replace(PRESETS["default"], config=SMALL)
        patch.setitem(PRESETS, "default", preset)
        argv = ["train", "--trials", "2", "--horizon", "8", "--quiet", "--out", str(path)]
        assert mcpilco.cli.main(argv) == 0
    return path


@pytest.fixture
def run(made_once, tmp_path) -> RunFolder:
    """A copy of it, to be changed."""
    shutil.copytree(made_once, tmp_path / "run")
    return RunFolder.open(tmp_path / "run")


@pytest.fixture
def history(run) -> History:
    return read_history(run)
