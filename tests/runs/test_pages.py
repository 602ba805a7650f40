"""What holds of the page of every run."""

from __future__ import annotations

import importlib.util
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import pytest
from harness import BEGIN, END
from matplotlib.figure import Figure

RUNS = Path(__file__).parents[2] / "runs"
PAGES = sorted(RUNS.glob("*/README.md"))

WRITES: dict[str, Callable[[ModuleType, Path], None]] = {
    "cartpole_swingup": lambda run, out: run.write_readmes(out),
    "collision": lambda run, out: run.write_page(out, out / "README.md", run.DETECTORS, run.EITHER),
    "cost_growth": lambda run, out: run.write_readme(
        run.json.loads((out / "results.json").read_text()), out
    ),
    "crossing_the_gap": lambda run, out: run.pages.write(out),
    "gip": lambda run, out: run.pages.write(out, run.gathered(out), out / "README.md"),
    "mujoco_plants": lambda run, out: run.write_page(out),
}
"""how a page is written where it is not by `write_readme` of run.py"""
SCRIPTS = {"speed": "survey"}
"""where that is not run.py"""
UNKEPT = {
    "exported_policy": "needs a compiler to be written",
    "identified_double_pendulum": "keeps no results: it fits public recordings anew",
    "rig": "has no template beside its page",
}
"""pages that are not written from kept results, and why"""
KEPT = [page.parent.name for page in PAGES if page.parent.name not in UNKEPT]


def test_every_run_has_a_page():
    folders = {path.name for path in RUNS.iterdir() if (path / "run.py").exists()}
    assert folders <= {page.parent.name for page in PAGES}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_a_command_finds_the_marked_lines_of_its_page(page):
    text = page.read_text(encoding="utf-8")
    assert text.count(BEGIN) == text.count(END) == 1
    assert text.index(BEGIN) < text.index(END)


@contextmanager
def script(name: str) -> Iterator[ModuleType]:
    """A run's command as a module; modules of its folder are forgotten with it."""
    path, modules = list(sys.path), set(sys.modules)
    sys.path.insert(0, str(RUNS / name))
    file = RUNS / name / f"{SCRIPTS.get(name, 'run')}.py"
    spec = importlib.util.spec_from_file_location(f"{name}_page", file)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
        yield module
    finally:
        sys.path[:] = path
        for new in set(sys.modules) - modules:
            home = getattr(sys.modules[new], "__file__", None) or ""
            if home.startswith(str(RUNS)):
                del sys.modules[new]


def no_picture(_: Figure, file: object, **__: object) -> None:
    if isinstance(file, Path):
        file.touch()


@pytest.mark.parametrize("name", KEPT)
def test_a_page_is_what_its_results_say(name, tmp_path, monkeypatch):
    """Where it is not, the run's command writes it anew."""
    monkeypatch.setattr(Figure, "savefig", no_picture)
    out = tmp_path / name
    out.mkdir()
    for file in ("README.md", "results.json"):
        if (RUNS / name / file).exists():
            shutil.copy(RUNS / name / file, out)
    for folder in ("results", "stability"):
        if (RUNS / name / folder).exists():
            (out / folder).symlink_to(RUNS / name / folder)
    before = (out / "README.md").read_text(encoding="utf-8")
    with script(name) as run:
        WRITES.get(name, lambda run, out: run.write_readme(out))(run, out)
    assert (out / "README.md").read_text(encoding="utf-8") == before
