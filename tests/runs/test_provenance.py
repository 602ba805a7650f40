"""Laws of the digest of the code that a result depends on, in a small project and in ours."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import provenance
import pytest
from provenance import Code

from mcpilco.config import PolicyConfig, SearchConfig

pytestmark = pytest.mark.xdist_group("provenance")  # one process reads all code for all of them
FILES = {
    "mcpilco/__init__.py": "",
    "mcpilco/gap/__init__.py": "import lazy_loader\n",
    "mcpilco/gap/__init__.pyi": "from .find import find as find\n",
    "mcpilco/gap/find.py": (
        '"""Finds."""\n'
        "from __future__ import annotations\n"
        "from typing import TYPE_CHECKING\n"
        "from mcpilco.plant import force\n"
        "if TYPE_CHECKING:\n    from mcpilco.show import Page\n"
        "LIMIT = 3\n"
        "UNUSED = 4\n"
        "def find(page: Page):\n"
        '    """Says where."""\n'
        "    from mcpilco.late import last\n"
        "    return force(LIMIT) + last()\n"
    ),
    "mcpilco/plant.py": (
        "KINDS = {}\n"
        "def register(name, value):\n    KINDS[name] = value\n"
        "register('spring', 1)\n"
        "def force(x):\n    return KINDS['spring'] * x\n"
        "def drawn():\n    return open('arm.xml')\n"
    ),
    "mcpilco/late.py": "def last():\n    return 1\n",
    "mcpilco/show.py": "class Page:\n    width = 1\n",
    "mcpilco/arm.xml": "<arm/>",
    "envs/arm.py": "class Arm:\n    pass\n",
    "runs/harness.py": "def fill():\n    pass\ndef keep():\n    pass\n",
    "runs/all_tables.py": "TABLES = (1,)\ndef table_of():\n    return TABLES\n",
    "runs/one/run.py": (
        "from harness import fill, keep\n"
        "from all_tables import table_of\n"
        "from pages import table\n"
        "from mcpilco.gap import find\n"
        "SIZE = 1\n"
        "def solve():\n    table_of()\n    return find(SIZE)\n"
        "def main():\n    keep(solve())\n    fill(table())\n"
    ),
    "runs/one/pages.py": "from mcpilco.show import Page\ndef table():\n    return Page()\n",
}


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Code]:
    """The code of `solve` in a small project in which some texts are others."""

    def code(made_by: tuple[str, ...] = ("run:solve",), **changes: str) -> Code:
        for name, text in FILES.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            for old, new in changes.items():
                text = text.replace(old, new)
            path.write_text(text)
        monkeypatch.setattr(provenance, "ROOT", tmp_path)
        monkeypatch.setattr(provenance, "RUNS", tmp_path / "runs")
        monkeypatch.setattr(provenance, "SOURCES", provenance.sources())
        provenance.forget()
        return Code(tmp_path / "runs/one", made_by)

    yield code
    monkeypatch.undo()
    provenance.forget()


@pytest.mark.parametrize(
    "change",
    [
        {"LIMIT = 3": "LIMIT = 5"},
        {"return force(": "return -force("},
        {"'spring', 1": "'spring', 2"},
        {"KINDS[name] = value": "KINDS[name] = -value"},
        {"return 1": "return 2"},
        {"SIZE = 1": "SIZE = 2"},
    ],
    ids=str,
)
def test_a_change_of_what_a_result_reaches_changes_its_digest(project, change):
    before = project().digest
    assert project(**change).digest != before


@pytest.mark.parametrize(
    "change",
    [
        {"Says where": "Tells where"},
        {"UNUSED = 4": "UNUSED = 5"},
        {"LIMIT = 3": "LIMIT = 3  # of all"},
        {"width = 1": "width = 2"},
        {"return Page()": "return Page"},
        {"fill(table())": "fill(table() + table())"},
        {"def fill():\n    pass": "def fill():\n    return"},
        {"open('arm.xml')": "open('leg.xml')"},
        {"<arm/>": "<leg/>"},
        {"TABLES = (1,)": "TABLES = (2,)"},
        {"class Arm:\n    pass": "class Arm:\n    mass = 1"},
    ],
    ids=str,
)
def test_a_change_of_words_or_of_what_it_does_not_reach_changes_nothing(project, change):
    before = project().digest
    assert project(**change).digest == before


def test_the_parts_name_the_packages_that_changed(project):
    before = project().parts
    assert set(before) == {"mcpilco", "mcpilco.gap", "runs.one"}
    assert project(**{"LIMIT = 3": "LIMIT = 5"}).changed(before) == ["mcpilco.gap"]


def test_a_file_that_the_code_names_counts_where_the_code_is_reached(project):
    made_by = ("mcpilco.plant:drawn",)
    before = project(made_by).digest
    assert project(made_by, **{"<arm/>": "<leg/>"}).digest != before


def test_what_is_found_by_a_string_counts_where_it_is_named(project):
    made_by = ("run:solve", "envs.arm:Arm")
    before = project(made_by).digest
    assert project(made_by, **{"class Arm:\n    pass": "class Arm:\n    mass = 1"}).digest != before


@pytest.mark.parametrize("root", ["run:absent", "absent:solve", "mcpilco.absent", "envs/no.xml"])
def test_a_root_that_is_not_there_is_an_error(project, root):
    with pytest.raises(LookupError, match="made_by must name"):
        project((root,))


def test_a_file_that_is_edited_while_the_process_runs_is_noticed(project, tmp_path):
    code = project()
    assert not provenance.edited(code.files)
    (tmp_path / "mcpilco/plant.py").write_text("KINDS = 1\n")
    assert provenance.edited(code.files)


# Nothing is missed --------------------------------------------------------------------------------


def executed(job: Callable[[], object]) -> set[tuple[Path, str]]:
    """The functions and classes of the product in which Python runs during a job."""
    tops = tuple(str(provenance.ROOT / top) for top in provenance.PRODUCT)
    found: set[tuple[Path, str]] = set()

    def profile(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(tops):
            name = frame.f_code.co_qualname.partition(".")[0]
            found.add((Path(frame.f_code.co_filename), name))

    sys.setprofile(profile)
    try:
        job()
    finally:
        sys.setprofile(None)
    return {(path, name) for path, name in found if not name.startswith(("<", "__"))}


def jobs() -> Iterator[object]:
    from all_tables import TABLES

    by_title = {f"{table.run} {table.results}": table for table in TABLES}

    def seed() -> object:
        from mcpilco.config import Config
        from mcpilco.sweep import Settings, run_seed

        search = SearchConfig(particles=8, steps=(2,), restarts=(0,), evaluation_particles=8)
        config = Config(policy=PolicyConfig(bases=10), search=search)
        return run_seed(
            Settings("envs:mcpilco/CartPoleSwingUp-v0", config=config, trials=1, fresh=2), 0
        )

    def chain() -> object:
        from run import structure  # that of kinematics

        return structure("noise", 0)

    def gap() -> object:
        from run import solve  # that of hidden_effects

        return solve("none", 1280, {}, with_peers=False)

    slow = pytest.mark.slow
    yield pytest.param(by_title["hidden_effects results/none/*.json"], gap, id="gap", marks=slow)
    swing_up = by_title["cartpole_swingup results/default/seeds/*.json"]
    yield pytest.param(swing_up, seed, id="seed", marks=slow)
    yield pytest.param(by_title["kinematics results/noise/*.json"], chain, id="chain")


@pytest.mark.parametrize(("table", "job"), list(jobs()))
def test_all_code_that_a_result_runs_is_in_its_digest(table, job, monkeypatch):
    monkeypatch.syspath_prepend(provenance.RUNS / table.run)
    monkeypatch.delitem(sys.modules, "run", raising=False)
    job()  # what only an import runs is no part of the result
    nodes = {(node.path, node.name) for node in table.code.nodes}
    missed = {(p, n) for p, n in executed(job) if (p, n) not in nodes and (p, "") not in nodes}
    assert not missed
    monkeypatch.delitem(sys.modules, "run", raising=False)
