"""What the tests of several runs need."""

from __future__ import annotations

import dataclasses
import importlib.util
import sys
from pathlib import Path

import pytest

from mcpilco.config import PRESETS, PolicyConfig, SearchConfig

RUNS = Path(__file__).parent.parent.parent / "runs"

sys.path.append(str(RUNS))  # harness.py and other modules that runs share


@pytest.fixture(scope="module")
def home(request) -> Path:
    """The folder of the run that a module tests: runs/x for test_x.py."""
    return RUNS / request.path.stem.removeprefix("test_")


@pytest.fixture(scope="module")
def run(home):
    """Its command, as a module."""
    before = list(sys.path)
    spec = importlib.util.spec_from_file_location(f"{home.name}_run", home / "run.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]
    sys.path[:] = before


@pytest.fixture
def hasty(monkeypatch):
    """A preset that learns nothing in no time."""
    search = SearchConfig(particles=8, steps=(2,), restarts=(0,), evaluation_particles=8)
    config = dataclasses.replace(
        PRESETS["default"].config, policy=PolicyConfig(bases=10), search=search
    )
    preset = dataclasses.replace(PRESETS["default"], config=config)
    monkeypatch.setitem(PRESETS, "default", preset)


@pytest.fixture
def page_of_two(run, tmp_path, monkeypatch):
    """Runs it twice with --quick; the page that both write, for the second has nothing to do."""

    def pages(*arguments: str) -> str:
        monkeypatch.setattr(sys, "argv", ["run.py", "--quick", *arguments, "--out", str(tmp_path)])
        texts = []
        for _ in range(2):
            assert run.main() == 0
            texts.append((tmp_path / "README.md").read_text())
        assert texts[0] == texts[1]
        return texts[0]

    return pages
