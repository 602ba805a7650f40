"""The documentation tells the truth: its Python runs, its commands parse, its tables agree.

A newcomer follows each page in a folder outside the clone (`tests/newcomer.py`): commands and
Python run as they stand, with a small agent in place of the presets' so that they take seconds.
"""

from __future__ import annotations

import dataclasses
import importlib
import itertools
import json
import os
import re
import shlex
import sys
import tomllib
import warnings
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest

import mcpilco.cli
from mcpilco.config import PRESETS
from tests import newcomer
from tests.mcpilco.point import TINY

ROOT = Path(__file__).parent.parent


def script(name: str) -> ModuleType:
    """A script of the documentation, as a module."""
    spec = spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


build_reference = script("build_reference")
count_trips = script("count_trips")
write_tables = script("write_tables")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]

NAMES = "|".join(
    re.sub("(?<=[a-z])(?=[A-Z])", "-", kind.__name__).lower() for kind in mcpilco.cli.COMMANDS
)
"""of all commands, as one pattern"""
QUICK = {
    "CONTRIBUTING.md",
    "extend-kernel.md",
    "mujoco-plants.md",
    "plants.md",
    "recordings.md",
}
"""pages that take some seconds of one core; the others take up to some minutes"""
NOTHING_TO_DO = {"map.md"}
"""pages without commands and without files and Python to run"""


def text(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def python_blocks(page: Path) -> list[tuple[str, str]]:
    """Titles (or "") and texts of the fenced Python blocks."""
    fence = re.compile(r'^```python(?: title="(.*?)")?\n(.*?)^```$', re.MULTILINE | re.DOTALL)
    return fence.findall(text(page))


def shell_lines(page: Path) -> list[str]:
    """The lines of indented blocks, joined where one goes on in the next, without comments."""
    prose = re.sub(r"^```.*?^```$", "", text(page), flags=re.MULTILINE | re.DOTALL)
    joined = prose.replace("\\\n", " ")
    return [line.strip() for line in joined.splitlines() if line.startswith("    ")]


def commands(page: Path) -> list[list[str]]:
    """The arguments of each `mcpilco` command, after the name and any variables before it."""
    found = []
    for line in shell_lines(page):
        match = re.search(rf"(?:^|\s)mcpilco ((?:{NAMES})\b.*)", line)
        if match:
            found.append(shlex.split(match[1], comments=True))
    return found


def pages_with(what: Any) -> list[Any]:
    return [pytest.param(page, id=page.name) for page in PAGES if what(page)]


@pytest.fixture
def my_env(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The page's `my_env.py`, imported from a folder of its own, which is the present one."""
    blocks = dict(python_blocks(ROOT / "docs" / "your-own-env.md"))
    (tmp_path / "my_env.py").write_text(blocks["my_env.py"], encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("my_env")
    del sys.modules["my_env"]
    gymnasium.registry.pop("My/Pendulum-v0")


# --- a newcomer -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.name, marks=[pytest.mark.slow] * (page.name not in QUICK))
        for page in PAGES
        if page.name not in NOTHING_TO_DO
    ],
)
def test_a_newcomer_can_follow_the_page_word_by_word(page: Path, tmp_path: Path) -> None:
    newcomer.follow(page, tmp_path)


def test_every_other_page_has_nothing_to_do() -> None:
    assert {page.name for page in PAGES if not list(newcomer.steps(page))} == NOTHING_TO_DO


def test_every_page_to_follow_says_how_long_it_takes() -> None:
    time = r"\b(about|some|within|takes?|after) (\w+ ){0,3}?(\d+ s|seconds?|minutes?)\b"
    pages = [page for page in PAGES if page.parent.name == "docs" or page.name == "README.md"]
    silent = {page.name for page in pages if not re.search(time, " ".join(text(page).split()))}
    assert silent == NOTHING_TO_DO


@pytest.mark.parametrize(
    ("steps", "reason"),
    [
        ("```python\nimport tests\n```\n", "No module named 'tests'"),
        ("    python runs.py\n", "runs.py"),
        ('```python title="a.py"\nb = 1\n```\n\n```python\nb\n```\n', "'b' is not defined"),
        ("    mcpilco gap log.csv --out gap\n", "log.csv"),
        ("    mcpilco identify a.csv --model envs/arms/scara.xml --out b\n", "envs/arms/scara.xml"),
    ],
)
def test_a_newcomer_stops_where_a_page_needs_what_it_did_not_give(
    steps: str, reason: str, tmp_path: Path
) -> None:
    (tmp_path / "page.md").write_text(f"# A page\n\n{steps}", encoding="utf-8")
    with pytest.raises(AssertionError, match=rf"^page\.md:\d: (.|\n)*{reason}"):
        newcomer.follow(tmp_path / "page.md", tmp_path)


def test_every_exception_for_a_command_is_made_somewhere() -> None:
    said = [step.text for page in PAGES for step in newcomer.steps(page) if step.kind == "command"]
    for pattern in (*newcomer.QUICKER, *newcomer.NOT_RUN, *newcomer.EXIT_CODES):
        assert any(re.search(pattern, command) for command in said), pattern


# --- Python ---------------------------------------------------------------------------------------


def test_the_page_on_own_envs_makes_an_env_that_gymnasium_accepts(my_env: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized space.*")
        exec(dict(python_blocks(ROOT / "docs" / "your-own-env.md"))["check.py"], {})


def test_the_files_of_the_page_on_others_envs_are_those_that_were_measured() -> None:
    page, cases = ROOT / "docs" / "other-envs.md", ROOT / "runs" / "other_envs"
    blocks = dict(re.findall(r'^```\w+ title="(.*?)"\n(.*?)^```$', text(page), re.M | re.S))
    assert blocks["balance.py"] == text(cases / "balance.py")
    measured = tomllib.loads(text(cases / "pendulum.toml"))
    assert tomllib.loads(blocks["turning.toml"]) == measured


def test_the_pendulum_of_the_page_needs_more_than_one_push(my_env: Any) -> None:
    """Its motor cannot hold it level, so the page may say that it is too weak."""
    assert my_env.TORQUE_LIMIT < my_env.MASS * my_env.GRAVITY * my_env.LENGTH


def test_the_pendulum_of_the_page_keeps_its_energy_without_friction(
    my_env: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(my_env, "FRICTION", 0.0)

    def energy(state: Any) -> float:
        height = my_env.tip(state)[2]
        speed = my_env.LENGTH * state[1]
        return my_env.MASS * (0.5 * speed**2 + my_env.GRAVITY * height)

    start = np.array([2.0, 1.0])
    assert energy(my_env.advance(start, 0.0)) == pytest.approx(energy(start), abs=1e-6)


NOTEBOOK = ROOT / "docs" / "learn-and-gap.ipynb"


def cells(kind: str) -> list[str]:
    """The texts of the notebook's cells: code or markdown."""
    found = json.loads(text(NOTEBOOK))["cells"]
    return ["".join(cell["source"]) for cell in found if cell["cell_type"] == kind]


@pytest.mark.slow
def test_the_notebook_runs_up_to_the_investigation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unchecked_shapes: None
) -> None:
    small = dataclasses.replace(TINY, horizon=None)
    preset = dataclasses.replace(PRESETS["default"], config=small)
    monkeypatch.setitem(PRESETS, "default", preset)
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {}
    for cell in itertools.takewhile(lambda cell: "investigate" not in cell, cells("code")):
        exec(cell, namespace)
    assert Path("swing_up.rrd").stat().st_size > 0
    assert len(namespace["recordings"]) == 3


def test_the_notebook_is_stored_without_outputs_and_leads_somewhere() -> None:
    code = [cell for cell in json.loads(text(NOTEBOOK))["cells"] if cell["cell_type"] == "code"]
    assert not [cell["outputs"] for cell in code if cell["outputs"] or cell["execution_count"]]
    targets = re.findall(r"\]\(([^)\s]+)\)", "\n".join(cells("markdown")))
    local = [target for target in targets if "://" not in target]
    assert local
    assert not [target for target in local if not (NOTEBOOK.parent / target).exists()]


@pytest.mark.slow
def test_the_notebook_runs_in_a_kernel_and_shows_its_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    nbclient = pytest.importorskip("nbclient", reason="runs notebooks; in the extra dev")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(ROOT), os.environ.get("PYTHONPATH", ""))))
    monkeypatch.delenv("MPLBACKEND", raising=False)  # which a command in this process has set
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    place = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(notebook, timeout=None, resources=place).execute()
    shown = [
        output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", ())
    ]
    tables = [data["text/html"] for data in shown if "text/html" in data]
    assert len(tables) == 2
    assert "<td>yes</td>" in tables[0]  # the second policy swings the pole up
    assert "<td>coulomb_friction</td>" in tables[1]
    assert any("image/png" in data for data in shown)


# --- commands -------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", pages_with(commands))
def test_every_command_is_understood(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for kind in vars(mcpilco.cli).values():
        if is_dataclass(kind):
            monkeypatch.setattr(kind, "__call__", lambda self: 0)
    for arguments in commands(page):
        assert mcpilco.cli.main(arguments) == 0, shlex.join(arguments)


def test_every_make_target_exists() -> None:
    targets = set(re.findall(r"^([a-z-]+(?: [a-z-]+)*):", text(ROOT / "Makefile"), re.MULTILINE))
    known = {name for group in targets for name in group.split()}
    for page in PAGES:
        named = re.findall(r"(?:^ {4}|`)make ([a-z-]+)", text(page), re.MULTILINE)
        assert set(named) <= known, page.name


def test_make_train_installs_what_the_readme_runs_after_it() -> None:
    """`mcpilco report` needs an extra; the other commands beside it need none."""
    after = text(ROOT / "README.md").partition("make train")[2]
    assert "mcpilco report RUN" in after
    core = re.search(r"^\$\(CORE_READY\):.*\n((?:\t.*\n)+)", text(ROOT / "Makefile"), re.MULTILINE)
    assert '-e ".[report]"' in core[1]


# --- what is named exists -------------------------------------------------------------------------


@pytest.mark.parametrize("page", pages_with(text))
def test_every_file_named_exists(page: Path) -> None:
    places = ("mcpilco", "envs", "baselines", "tests", "runs", "docs")
    named = re.findall(rf"\b(?:{'|'.join(places)})/[\w/.-]*\w\.(?:py|md|png)\b", text(page))
    missing = [name for name in named if not (ROOT / name).exists()]
    assert not missing


@pytest.mark.parametrize("page", pages_with(text))
def test_every_link_and_picture_leads_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\(([^)\s]+)\)", text(page))
    local = [target.partition("#")[0] for target in targets if "://" not in target]
    paths = [(page.parent / target).resolve() for target in local if target]
    rooms = {f"{init.parent.name}.md" for init in (ROOT / "mcpilco").glob("*/__init__.py")}
    made = {"mcpilco.md", *(f"mcpilco.{room}" for room in rooms)}  # by docs/build_reference.py
    assert not [
        path
        for path in paths
        if not path.exists() and not (path.parent.name == "reference" and path.name in made)
    ]
    if page.parent.name == "docs":  # the pages are built alone
        assert not [path for path in paths if not path.is_relative_to(page.parent)]


@pytest.mark.parametrize("page", pages_with(text))
def test_every_dotted_name_exists(page: Path) -> None:
    for name in set(re.findall(r"`(mcpilco(?:\.\w+)+)`", text(page))):
        module, _, last = name.rpartition(".")
        found = hasattr(importlib.import_module(module), last) or find_spec(name) is not None
        assert found, name


def test_the_styles_of_the_site_exist() -> None:
    listed = re.search(r"^extra_css:\n((?:  - .*\n)+)", text(ROOT / "mkdocs.yml"), re.MULTILINE)
    named = re.findall(r"- (.*)", listed[1])
    assert named
    assert not [name for name in named if not (ROOT / "docs" / name).exists()]


def test_pictures_are_small() -> None:
    sizes = {path.name: path.stat().st_size for path in (ROOT / "docs" / "images").glob("*.png")}
    assert sizes
    assert max(sizes.values()) < 300_000, sizes


# --- tables ---------------------------------------------------------------------------------------


def _shown(value: Any) -> str:
    """A number of a configuration as the table writes it."""
    match value:
        case None | ():
            return "none"
        case bool():
            return "yes" if value else "no"
        case tuple() | list():
            return ", ".join(map(_shown, value))
        case str():
            return value
    return f"{value:g}"


def _entries(config: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Dotted names and values of all entries; of a list of parts, each entry's values in a row."""
    for field in fields(config):
        name, value = prefix + field.name, getattr(config, field.name)
        if is_dataclass(value):
            yield from _entries(value, f"{name}.")
        elif isinstance(value, tuple) and value and is_dataclass(value[0]):
            for part in fields(value[0]):
                yield f"{name}.{part.name}", _shown([getattr(v, part.name) for v in value])
        else:
            yield name, _shown(value)


def test_the_table_of_presets_holds_their_numbers() -> None:
    page = ROOT / "docs" / "how-it-works.md"
    rows = re.findall(r"^\| `([\w.]+)` \| (.*?) \| (.*?) \| (.*?) \|", text(page), re.MULTILINE)
    table = {entry: tuple(values) for entry, *values in rows}
    presets = [dict(_entries(PRESETS[name].config)) for name in ("default", "thesis", "tro2022")]
    assert table == {entry: tuple(p[entry] for p in presets) for entry in presets[0]}


def test_the_tables_of_effects_and_plants_are_the_catalogue_and_the_registry() -> None:
    """Written by `python docs/write_tables.py`."""
    page = text(ROOT / "docs" / "plants.md")
    assert write_tables.written(page) == page
    assert page.count(write_tables.EFFECTS) == page.count(write_tables.PLANTS_HEAD) == 1


def test_the_map_has_the_rooms_in_the_order_that_is_checked() -> None:
    project = tomllib.loads(text(ROOT / "pyproject.toml"))
    layers = project["tool"]["importlinter"]["contracts"][0]["layers"]
    present = {path.stem for path in (ROOT / "mcpilco").iterdir()}
    checked = [set(layer.split(" | ")) & present for layer in reversed(layers)]
    cells = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", text(ROOT / "docs" / "map.md"), re.MULTILINE)
    rows = [re.findall(r"\w+", cell) for cell in cells]
    level = {name: number for number, layer in enumerate(checked) for name in layer}
    assert {name for row in rows for name in row} == set(level)
    order = [max(level[name] for name in row) for row in rows]
    assert order == sorted(order)


def test_the_site_has_a_reference_page_for_every_room() -> None:
    project = tomllib.loads(text(ROOT / "pyproject.toml"))
    layers = project["tool"]["importlinter"]["contracts"][0]["layers"]
    names = {name for layer in layers for name in layer.split(" | ")}
    packages = {name for name in names if (ROOT / "mcpilco" / name / "__init__.py").exists()}
    nav = re.findall(r"reference/([\w.]+)\.md", text(ROOT / "mkdocs.yml"))
    assert {f"mcpilco.{name}" for name in packages} <= set(nav)
    assert set(nav) == set(build_reference.rooms())


@pytest.mark.parametrize("room", build_reference.rooms())
def test_a_reference_page_has_every_public_name(room: str) -> None:
    listed = [name for name in importlib.import_module(room).__all__ if name.isidentifier()]
    modules = [
        name
        for name in listed
        if isinstance(getattr(importlib.import_module(room), name), ModuleType)
    ]
    assert set(build_reference.public_names(room)) == set(listed) - set(modules)


def test_every_page_is_in_the_navigation() -> None:
    nav = set(re.findall(r": ([\w-]+\.md)$", text(ROOT / "mkdocs.yml"), re.MULTILINE))
    assert nav == {page.name for page in (ROOT / "docs").glob("*.md")}


@pytest.mark.parametrize("trip", count_trips.TRIPS, ids=lambda trip: trip.title)
def test_a_trip_through_the_house_is_short(trip: Any) -> None:
    assert trip.files_read <= trip.files
    assert trip.edits is None or trip.files_edited <= trip.edits
    assert trip.lines is None or trip.total <= trip.lines
    assert trip.most_hops is None or len(trip.hops) - 1 <= trip.most_hops


def test_the_map_shows_the_trips_as_they_are() -> None:
    """As `python docs/count_trips.py --write` writes them, but for a tenth of the lines."""
    page = text(ROOT / "docs" / "map.md")
    shown, counted = (
        re.split(r"([\d,]+)(?= lines)", each) for each in (page, count_trips.written(page))
    )
    rows = [re.sub(r"\| [\d]+ \|", "|", each) for each in shown[::2]]
    assert rows == [re.sub(r"\| [\d]+ \|", "|", each) for each in counted[::2]]
    told, true = ([int(each.replace(",", "")) for each in side[1::2]] for side in (shown, counted))
    assert told == pytest.approx(true, rel=0.1)


@pytest.mark.parametrize("trip", [trip for trip in count_trips.TRIPS if trip.hops])
def test_the_hops_of_a_trip_are_functions_of_its_files(trip: Any) -> None:
    found = [count_trips.definitions(text(ROOT / stop.path)) for stop in trip.stops]
    for hop in trip.hops:
        assert any(hop in names for names in found), hop


def test_the_run_folder_is_explained_file_by_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unchecked_shapes: None
) -> None:
    monkeypatch.chdir(tmp_path)
    small = dataclasses.replace(PRESETS["default"], config=newcomer.SMALL)
    monkeypatch.setitem(PRESETS, "default", small)
    assert mcpilco.cli.main(["train", "--trials", "1", "--out", "run", "--quiet"]) == 0
    files = {path.relative_to("run") for path in Path("run").rglob("*") if path.is_file()}
    written = {re.sub(r"\d\d", "NN", path.as_posix()) for path in files}
    rows = re.findall(r"^\| `([\w./]+\.\w+)` \|", text(ROOT / "docs/getting-started.md"), re.M)
    assert set(rows) == written
