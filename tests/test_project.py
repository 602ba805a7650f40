"""Laws of the project around the code: it imports, it names what it has, its numbers agree."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import grimp
import jaxtyping
import pytest
import torch

import mcpilco
from mcpilco.policies import cart_pole_cost

pytestmark = pytest.mark.xdist_group("project")  # each file of the code is parsed once

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def modules(*packages: str) -> list[str]:
    """The dotted names of all modules, packages by their own name."""
    paths = [
        path.relative_to(ROOT) for package in packages for path in (ROOT / package).rglob("*.py")
    ]
    names = [".".join(path.with_suffix("").parts) for path in paths]
    return sorted(name.removesuffix(".__init__") for name in names if not name.endswith("__main__"))


def public_modules() -> list[str]:
    """The packages: they list their public names."""
    return [
        name for name in modules("mcpilco", "envs") if find_spec(name).submodule_search_locations
    ]


@pytest.mark.parametrize("name", modules("mcpilco", "envs", "baselines"))
def test_module_imports_and_says_what_it_is(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__doc__


@pytest.mark.parametrize("name", public_modules())
def test_every_public_name_exists(name: str) -> None:
    module = importlib.import_module(name)
    missing = [public for public in module.__all__ if not hasattr(module, public)]
    assert not missing


def test_version_is_the_projects() -> None:
    assert mcpilco.__version__ == PROJECT["version"]
    assert f"version: {PROJECT['version']}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert PROJECT["version"] in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_command_exists() -> None:
    module, function = PROJECT["scripts"]["mcpilco"].split(":")
    assert callable(getattr(importlib.import_module(module), function))


def test_the_command_line_loads_nothing_slow() -> None:
    """What keeps `mcpilco --help` fast."""
    slow = {"torch", "rerun", "gymnasium", "numba", "scipy", "mujoco", "stable_baselines3"}
    code = f"import sys, mcpilco.cli; print(sorted({slow!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


def test_importing_the_package_does_not_import_envs() -> None:
    code = "import sys, mcpilco.agent.agent; print({'envs', 'baselines'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout.strip() == "set()", done.stderr


@pytest.mark.parametrize("package", ["mcpilco", "envs"])
def test_types_are_published(package: str) -> None:
    assert (ROOT / package / "py.typed").exists()


INTEGERS = torch.zeros(4, dtype=torch.int64)  # where a cost says Float


def test_wrong_arrays_are_caught_while_tests_run() -> None:
    with pytest.raises(jaxtyping.TypeCheckError, match="states"):
        cart_pole_cost()(INTEGERS)


@pytest.mark.usefixtures("unchecked_shapes")
def test_wrong_arrays_reach_the_code_where_a_test_asks_for_it() -> None:
    assert cart_pole_cost()(INTEGERS).shape == ()


# --- the house ------------------------------------------------------------------------------------

TOPS = ("mcpilco", "envs", "baselines")
ROOMS = sorted(init.parent.name for init in (ROOT / "mcpilco").glob("*/__init__.py"))


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def sources(*folders: str) -> list[Path]:
    return sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))


def source_of(package: str) -> Path:
    """The file with a package's public names: its stub where it loads them lazily."""
    folder = ROOT.joinpath(*package.split("."))
    if not folder.is_dir():
        return folder.with_suffix(".py")
    stub = folder / "__init__.pyi"
    return stub if stub.exists() else folder / "__init__.py"


@cache
def public_names(package: str) -> frozenset[str]:
    for node in tree(source_of(package)).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return frozenset(ast.literal_eval(node.value))
    return frozenset()


def packages() -> list[str]:
    inits = [path for path in sources(*TOPS) if path.name == "__init__.py"]
    return [".".join(path.parent.relative_to(ROOT).parts) for path in inits]


def lines(paths: list[Path]) -> int:
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def test_the_top_has_few_files_and_rooms() -> None:
    assert len(list((ROOT / "mcpilco").glob("*.py"))) <= 7
    assert len(ROOMS) <= 20


def test_the_house_has_few_files() -> None:
    assert len(sources(*TOPS)) <= 320


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_is_of_a_size_to_read(room: str) -> None:
    assert lines(sources(f"mcpilco/{room}")) <= 6000


def _strongly_connected(edges: dict[str, set[str]]) -> Iterator[list[str]]:
    """The groups of modules that reach each other (Tarjan's algorithm)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []

    def visit(node: str) -> Iterator[list[str]]:
        index[node] = low[node] = len(index)
        stack.append(node)
        for target in sorted(edges[node]):
            if target not in index:
                yield from visit(target)
                low[node] = min(low[node], low[target])
            elif target in stack:
                low[node] = min(low[node], index[target])
        if low[node] == index[node]:
            group = stack[stack.index(node) :]
            del stack[stack.index(node) :]
            if len(group) > 1:
                yield group

    for node in sorted(edges):
        if node not in index:
            yield from visit(node)


def test_no_imports_go_in_a_circle() -> None:
    """Neither those of functions nor those that a room makes when a name of its is first used."""
    graph = grimp.build_graph(*TOPS, exclude_type_checking_imports=True, cache_dir=None)
    edges = {
        module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules
    }
    for package in packages():
        for node in tree(source_of(package)).body:
            if isinstance(node, ast.ImportFrom) and node.level:
                module = f"{package}.{node.module}" if node.module else package
                inner = {f"{module}.{name.name}" for name in node.names}
                edges[package] |= ({module} | inner) & set(edges) - {package}
    assert list(_strongly_connected(edges)) == []


def test_a_circle_would_be_found() -> None:
    edges = {"a": {"b"}, "b": {"c"}, "c": {"a", "d"}, "d": set()}
    assert [sorted(group) for group in _strongly_connected(edges)] == [["a", "b", "c"]]


@pytest.mark.parametrize("package", packages())
def test_no_public_name_is_that_of_a_submodule(package: str) -> None:
    """Loading the module would put it in the place of what has its name."""
    folder = ROOT.joinpath(*package.split("."))
    modules = {path.stem for path in folder.iterdir() if path.suffix == ".py"}
    named = {
        name.asname or name.name
        for node in tree(source_of(package)).body
        if isinstance(node, ast.ImportFrom) and node.module
        for name in node.names
    }
    assert not public_names(package) & named & modules


MEASURED_INSIDE = {"runs/speed/parts.py"}  # times the parts of a compiled policy step


def test_rooms_are_used_by_their_public_names() -> None:
    """Another room, an env, a baseline or a run imports what a package's `__all__` lists."""
    private = [
        f"{path.relative_to(ROOT)}:{node.lineno}: {node.module}.{name.name}"
        for path in sources(*TOPS, "runs")
        if str(path.relative_to(ROOT)) not in MEASURED_INSIDE
        for node in ast.walk(tree(path))
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").startswith("mcpilco.")
        and (room := str(node.module).split(".")[1]) in ROOMS
        and not path.is_relative_to(ROOT / "mcpilco" / room)
        for name in node.names
        if name.name not in public_names(str(node.module))
    ]
    assert not private, "\n".join(private)


def test_a_step_and_a_model_are_one_thing_each() -> None:
    classes = Counter(
        node.name
        for path in sources(*TOPS)
        for node in ast.walk(tree(path))
        if isinstance(node, ast.ClassDef)
    )
    assert classes["Step"] <= 1
    assert classes["Model"] <= 1


def _docstrings(path: Path) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            docstring = ast.get_docstring(node) or ""
            yield getattr(node, "lineno", 1), docstring.partition("\n")[0]


def test_no_docstring_begins_as_a_riddle() -> None:
    riddles = [
        f"{path.relative_to(ROOT)}:{line}: {first}"
        for path in sources(*TOPS)
        for line, first in _docstrings(path)
        if re.match(r"What |Whether what", first)
    ]
    assert not riddles, "\n".join(riddles)


# --- what few modules may do ----------------------------------------------------------------------

WRITES = {
    "mcpilco/files.py": "whole or not at all, and through links",
    "mcpilco/logbook/callbacks.py": "lines, as they come",
    "mcpilco/machine/loop.py": "lines, as they come",
    "mcpilco/show/viewer.py": "the viewer's log, in a temporary folder",
}
"""modules that write files themselves; all others call mcpilco.files"""


def calls(path: Path) -> Iterator[tuple[int, str, list[ast.expr]]]:
    """Line, name and arguments of each call in a module."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Call):
            arguments = [*node.args, *(word.value for word in node.keywords)]
            yield node.lineno, ast.unparse(node.func), arguments


def _writes(name: str, arguments: list[ast.expr]) -> bool:
    """Whether a call makes or replaces a file by itself."""
    words = {a.value for a in arguments if isinstance(a, ast.Constant) and isinstance(a.value, str)}
    name = f".{name.rpartition('.')[2]}" if "." in name else name
    to_disk = bool(arguments) and ast.unparse(arguments[0]) != "content"  # bytes in memory
    return (
        name in (".write_text", ".write_bytes", ".rename", ".copyfile", ".copy2", ".move")
        or name in (".savez", ".savez_compressed", ".to_csv", ".to_file", ".symlink_to", ".touch")
        or (name in ("open", ".open") and any(re.fullmatch("[wax]b?[+]?", word) for word in words))
        or (name == ".savefig" and to_disk)
    )


def test_files_are_written_in_one_place() -> None:
    found = {
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in sources(*TOPS)
        if str(path.relative_to(ROOT)) not in WRITES
        for line, name, arguments in calls(path)
        if _writes(name, arguments)
    }
    assert not found, "call mcpilco.files.write_bytes, or mcpilco.show.plots.write_picture"


def test_a_file_that_is_written_elsewhere_would_be_found() -> None:
    names = ("path.write_text('')", "open(path, 'w')", "(out / 'a').open(mode='wb')")
    names += ("figure.savefig(self.out / 'a.png')", "shutil.copyfile(a, b)", "np.savez(a, b=1)")
    for text in names:
        call = ast.parse(text, mode="eval").body
        assert isinstance(call, ast.Call)
        assert _writes(
            ast.unparse(call.func), [*call.args, *(word.value for word in call.keywords)]
        ), text


EXECUTES = {
    "mcpilco/__init__.py": "its own rooms",
    "mcpilco/agent/algorithms.py": "classes that are registered, modules that a user names",
    "mcpilco/agent/contract.py": "envs that are registered",
    "mcpilco/agent/task_file.py": "the task that a user names",
    "mcpilco/identification/noisy_inputs/methods.py": "scikit-learn",
    "mcpilco/plant/effects/own.py": "the effects that a user names",
    "mcpilco/plant/simulation/laws.py": "formulas of effects",
    "mcpilco/sweep/job.py": "an env that was made before, in batches",
    "baselines/sb3/library.py": "an env that was made before",
    "envs/mujoco_views.py": "MuJoCo's",
}
"""modules that may execute what they find by a name; none of them may take it from a file"""
TYPED = {
    "mcpilco/cli/options.py": "the options of a command",
    "mcpilco/sweep/job.py": "the settings of a sweep, which its user typed",
}
"""modules that may say that a user has typed a name: none that opens a run folder"""


def _executes(name: str) -> bool:
    """Whether a call may execute what it finds by a name, or in a file."""
    last = name.rpartition(".")[2]
    return (
        name in ("exec", "eval", "__import__", "compile", "gym.make", "gym.make_vec")
        or last in ("import_module", "exec_module", "run_path", "run_module", "load_module")
        or name in ("pickle.load", "pickle.loads", "torch.load", "joblib.load", "yaml.load")
    )


def test_names_are_executed_in_few_modules() -> None:
    """So a command cannot import what a run folder names: `make_env` and `find` import nothing."""
    found = {
        (str(path.relative_to(ROOT)), name)
        for path in sources(*TOPS)
        for _, name, _ in calls(path)
        if _executes(name) or name == "import_named"
    }
    typed = {module for module, name in found if name == "import_named"}
    assert typed == set(TYPED), "see mcpilco.agent.algorithms; a name out of a file is never typed"
    assert {module for module, name in found if name != "import_named"} == set(EXECUTES)
    readers = ("RunFolder", "read_json", "read_arrays", "read_groups")
    words = {module: (ROOT / module).read_text(encoding="utf-8") for module in EXECUTES | TYPED}
    assert not {m for m in words if any(word in words[m] for word in readers)}


# --- sentences ------------------------------------------------------------------------------------

UNCLEAR = {
    r"could be [^.]* as well\b|\bor as well\b": "cannot be distinguished from",
    r"hardly (show|reveal)|would not show": "have little power to detect",
    r"noise std off": "a residual of so many noise std",
    r"Missed most is": "the residual is largest in",
    r"\bat (small|large) (speed|change)s? of": "where the speed of ... is small",
    r"everywhere alike|stay alike": "at all speeds and amplitudes; cannot be distinguished",
    r"\bstate is (not )?whole\b|\bwhole state tells": "the state is Markov",
    r"Read of it:": "report",
    r"(parameters|sums of them|effects) can(not)? be told\b": "are identifiable",
    r"left over is no noise": "the residual is not noise",
}
"""phrases that had to be read twice, and what the field says"""


def unclear(text: str) -> list[str]:
    """The phrases of a text, or of the strings of a module, that `UNCLEAR` lists."""
    said = " ".join(re.sub(r'"\s*\n\s*f?"', "", text).split())
    return [found[0] for phrase in UNCLEAR for found in re.finditer(phrase, said)]


def test_no_sentence_has_to_be_read_twice() -> None:
    paths = [*sources(*TOPS), ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    found = {
        str(path.relative_to(ROOT)): phrases
        for path in paths
        if (phrases := unclear(path.read_text(encoding="utf-8")))
    }
    assert not found


@pytest.mark.parametrize(
    "text",
    [
        'f"it could be {others} as "\n    f"well"',
        "These recordings would\nhardly show it.",
        "The state is not whole: ...",
    ],
)
def test_an_unclear_sentence_would_be_found(text: str) -> None:
    assert unclear(text)


# --- tests mirror the tree ------------------------------------------------------------------------

ACROSS = {
    "mcpilco/show/plots/test_volterra": "plots of a Volterra series",
    "mcpilco/show/test_gap_film": "films of a gap, side by side",
    "baselines/sb3/test_presets": "presets of all algorithms",
    "mcpilco/agent/test_streams": "random streams of an agent",
    "mcpilco/cli/test_hostile": "files that are not what they should be",
    "mcpilco/gap/test_closed_loop": "a drive in a closed loop, behind a fine encoder",
    "mcpilco/gap/test_compute_budget": "the budget of an investigation",
    "mcpilco/mjcf/test_learned": "learned forces in MJCF",
    "mcpilco/search/test_continuation": "search from an easier problem",
    "mcpilco/sweep/test_line_up": "comparisons of sweeps",
    "baselines/sb3/test_commands": "commands of the command line",
    "envs/test_swing_up_vector": "swing_up_env, in batches",
    "mcpilco/agent/test_own_kernel": "a kernel of a user's own, in an agent",
    "mcpilco/cli/test_cli": "the commands of learning",
    "mcpilco/cli/test_gap_command": "the command",
    "mcpilco/cli/test_inverse_dynamics_command": "the command",
    "mcpilco/cli/test_kinematics_command": "the command",
    "mcpilco/cli/test_volterra_command": "the command",
    "mcpilco/identification/inverse_dynamics/test_forward": "forward dynamics of all models",
    "mcpilco/kernels/test_kernels": "the laws of all kernels",
    "mcpilco/plant/effects/test_catalogue": "the laws of all effects",
    "mcpilco/plant/equations/test_friction": "friction in the steps of the equations",
    "mcpilco/plant/equations/test_polynomial_force": "polynomial forces in the equations",
    "mcpilco/recordings/test_fuzz": "all readers",
    "mcpilco/recordings/test_measured": "public data",
    "mcpilco/recordings/test_one_reader": "all readers",
    "mcpilco/search/fused/test_processors": "fused, on other processors",
    "mcpilco/test_components": "runs/model_components",
    "mcpilco/test_fuzz": "all files that are read",
    "mcpilco/test_init": "the package",
    "mcpilco/test_other_envs": "runs/other_envs",
    "mcpilco/test_positions_run": "runs/partial_state",
    "mcpilco/test_survival": "runs that are killed",
}
"""test modules that look at several modules together, and at what"""


def test_tests_mirror_the_tree() -> None:
    """A test stands in the folder of its room and has its module's name, or a place in `ACROSS`."""
    folders = [ROOT / "tests" / top for top in TOPS]
    found = {
        path.relative_to(ROOT / "tests").with_suffix("").as_posix()
        for folder in folders
        for path in folder.rglob("test_*.py")
    }
    homeless = set()
    for name in found:
        folder, _, test = name.rpartition("/")
        module = ROOT / folder / test.removeprefix("test_")
        if not (module.with_suffix(".py").exists() or (module / "__init__.py").exists()):
            homeless.add(name)
    assert not homeless - set(ACROSS), "rename or move it to its module, or name what it tests"


def test_every_room_is_tested_in_the_folder_of_its_name() -> None:
    untested = [
        room for room in ROOMS if not list((ROOT / "tests/mcpilco" / room).glob("**/test_*.py"))
    ]
    assert not untested
