"""The code that a result depends on, as a digest that only a change of that code changes.

    made_by = Code(Path("runs/hidden_effects"), ["run:solve"])
    made_by.digest, made_by.parts

A result is made by a function. The digest is of what this function reaches: each function, class
and constant that it uses, and those that these use, through imports, also inside functions and
through the lazy `__init__` of a room. What only a table or a picture needs is not reached.
Comments, docstrings and the layout of the code do not count; the files that the code names, such as
`cartpole.xml`, do. What is found by a string (the class of an env or an algorithm) is not seen:
`made_by` names it beside the function. What says which code made a result makes none, and is left
out.
"""

from __future__ import annotations

import ast
import hashlib
import re
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
RUNS = ROOT / "runs"
PRODUCT = ("mcpilco", "envs", "baselines")
_LENGTH = 12
_REGISTERS = re.compile(r"\.register\b|\boverload\b")
"""decorators of functions that are used without being named"""
_ASSET = re.compile(r"[\w-]+\.(xml|toml|yml|npz|csv|j2)")


def sources() -> dict[Path, bytes]:
    """All files of code, with what they hold now."""
    paths = [path for top in PRODUCT for path in (ROOT / top).rglob("*.py*")]
    paths += [*RUNS.glob("*.py"), *RUNS.glob("*/*.py")]
    return {path: path.read_bytes() for path in paths if path.suffix in (".py", ".pyi")}


SOURCES = sources()
"""all files of code as this process found them when it began: a run may take hours"""
SAYS = ("all_tables.py", "evidence.py", "provenance.py")
"""those of runs/ that say by which code a result was made, and which seeds were chosen on"""


class Node(NamedTuple):
    """What a module defines by one name: a function, a class, a constant."""

    path: Path
    name: str = ""
    """empty: all of the module"""


class Code:
    """What some functions and modules reach."""

    def __init__(self, folder: Path, made_by: Sequence[str]) -> None:
        """Looks the roots up.

        Args:
            folder: of the run.
            made_by: `module:name` of the run, `module` of the product, or a file, from the root.

        Raises:
            LookupError: there is no such module, name or file.
        """
        self._files = [ROOT / root for root in made_by if "/" in root]
        roots = (_root(root, folder) for root in made_by if "/" not in root)
        self._roots = [node for found in roots for node in found]
        if missing := [path for path in self._files if not path.is_file()]:
            raise LookupError(f"made_by must name files that exist, got {missing[0]}.")

    @cached_property
    def nodes(self) -> frozenset[Node]:
        """All that is reached."""
        reached: set[Node] = set()
        waiting = list(self._roots)
        while waiting:
            node = waiting.pop()
            says = node.path.parent == RUNS and node.path.name in SAYS
            if node not in reached and not says:
                reached.add(node)
                waiting += _reached_from(node)
        return frozenset(reached)

    @cached_property
    def parts(self) -> dict[str, str]:
        """A digest for each package, and for each folder of runs."""
        texts: dict[str, list[str]] = {}
        for node in sorted(self.nodes):
            if text := _text(node):
                texts.setdefault(_package(node.path), []).append(f"{node.name}\n{text}")
        for path in sorted({*self._files, *(p for node in self.nodes for p in _assets(node))}):
            texts.setdefault(_package(path), []).append(_hashed(path.read_bytes()))
        return {
            package: _hashed("\n".join(found).encode())[:8]
            for package, found in sorted(texts.items())
        }

    @property
    def digest(self) -> str:
        """Of all parts."""
        return _hashed(repr(self.parts).encode())

    def changed(self, parts: Mapping[str, str]) -> list[str]:
        """The packages in which this code differs from one of these parts."""
        both = sorted({*parts, *self.parts})
        return [package for package in both if parts.get(package) != self.parts.get(package)]

    @property
    def files(self) -> dict[Path, str]:
        """The hash of each file that it is in, as this process found it when it began."""
        return {node.path: _hashed(SOURCES[node.path]) for node in self.nodes}


def edited(files: Mapping[Path, str]) -> bool:
    """Whether one of these files is another now."""
    return any(not path.exists() or _hashed(path.read_bytes()) != h for path, h in files.items())


def git(*arguments: str) -> str:
    """What git says of the project; nothing where there is none."""
    command = ["git", "-C", str(ROOT), *arguments]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


COMMIT = git("describe", "--always", "--dirty", "--abbrev=10") or None
"""that was checked out then, `-dirty` where files differed from it; None without git"""


def forget() -> None:
    """Forget what was read from `SOURCES`."""
    for remembers in (_tree, _bound, _reached_from, _text, _assets):
        remembers.cache_clear()


# What a module imports and defines ----------------------------------------------------------------


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(SOURCES[path])


@cache
def _bound(path: Path) -> dict[str, list[ast.stmt]]:
    """The statements of a module by the names that they bind; by "" those that only act."""
    found: dict[str, list[ast.stmt]] = {"": []}
    for statement in _tree(path).body:
        for name in _names(statement):
            found.setdefault(name, []).append(statement)
    return found


def _names(statement: ast.stmt) -> set[str]:
    if isinstance(statement, ast.FunctionDef | ast.ClassDef):
        wrapped = " ".join(map(ast.unparse, statement.decorator_list))
        return {statement.name, ""} if _REGISTERS.search(wrapped) else {statement.name}
    if isinstance(statement, ast.Import | ast.ImportFrom):
        return {name.asname or name.name.partition(".")[0] for name in statement.names}
    if isinstance(statement, ast.Expr):
        acts = isinstance(statement.value, ast.Call)
        return {""} if acts and not ast.unparse(statement).startswith("sys.path") else set()
    if isinstance(statement, ast.If) and re.search("TYPE_CHECKING|__main__", _condition(statement)):
        return set()
    inner = (_names(s) for s in ast.iter_child_nodes(statement) if isinstance(s, ast.stmt))
    stored = {
        node.id
        for node in ast.walk(statement)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
    }
    return stored.union(*inner, {""} if isinstance(statement, ast.For) else ())


def _condition(statement: ast.If) -> str:
    return ast.unparse(statement.test)


@cache
def _reached_from(node: Node) -> frozenset[Node]:
    """What a node uses, one step away."""
    return frozenset(_uses(node))


def _uses(node: Node) -> Iterator[Node]:
    if not node.name:
        for source in (node.path, node.path.with_suffix(".pyi")):
            if source in SOURCES:
                yield from _imported(_tree(source), source)
        return
    bound = _bound(node.path)
    for statement in _statements(node):
        if isinstance(statement, ast.Import | ast.ImportFrom):
            yield from _imported(statement, node.path, node.name)
            continue
        yield from _imported(statement, node.path)
        for used in ast.walk(statement):
            if isinstance(used, ast.Name) and used.id in bound:
                yield Node(node.path, used.id)


def _statements(node: Node) -> list[ast.stmt]:
    """What a node is made of, with what its module does when it is loaded."""
    if not node.name:
        return _tree(node.path).body
    bound = _bound(node.path)
    return [*bound[node.name], *bound[""]]


def _imported(tree: ast.AST, path: Path, only: str = "") -> Iterator[Node]:
    """What the import statements in a tree bring, but for those that only type checkers follow."""
    if isinstance(tree, ast.If) and "TYPE_CHECKING" in _condition(tree):
        return
    if isinstance(tree, ast.Import):
        for name in tree.names:
            if (home := _file(name.name, path)) is not None:
                yield Node(home)
    elif isinstance(tree, ast.ImportFrom):
        module = _absolute(tree, path)
        for name in tree.names:
            if not only or only == (name.asname or name.name):
                yield from _named(module, name.name, path)
    else:
        for child in ast.iter_child_nodes(tree):
            yield from _imported(child, path, only)


def _absolute(statement: ast.ImportFrom, path: Path) -> str:
    if not statement.level:
        return statement.module or ""
    package = path.parents[statement.level - 1].relative_to(ROOT).parts
    return ".".join((*package, *filter(None, [statement.module])))


def _named(module: str, name: str, path: Path) -> Iterator[Node]:
    """What `from module import name` brings."""
    inner, home = _file(f"{module}.{name}", path), _file(module, path)
    stub = home and home.with_suffix(".pyi")
    public = stub if stub in SOURCES else home
    bound = _bound(public).get(name, []) if public else []
    again = [s for s in bound if isinstance(s, ast.ImportFrom) and _absolute(s, public) != module]
    if again:
        for statement in again:
            yield from _imported(statement, public, name)
    elif home and not inner and name in _bound(home):
        yield Node(home, name)
    elif inner or home:
        yield Node(inner or home)


def _file(module: str, path: Path) -> Path | None:
    """The file of a module, if it is one of ours."""
    parts = module.split(".")
    near = [path.parent, RUNS] if _in_runs(path) else []
    for base in (*near, ROOT):
        stem = base.joinpath(*parts)
        for file in (stem.with_suffix(".py"), stem / "__init__.py"):
            if file in SOURCES:
                return file
    return None


def _root(root: str, folder: Path) -> list[Node]:
    module, _, name = root.partition(":")
    home = _file(module, folder / "run.py")
    nodes = list(_named(module, name, folder / "run.py")) if name else [Node(home)] if home else []
    if not nodes or any(node.name != name for node in nodes):
        raise LookupError(f"made_by must name what {folder.name} or the product has, got {root}.")
    return nodes


def _in_runs(path: Path) -> bool:
    return path.is_relative_to(RUNS)


def _package(path: Path) -> str:
    return ".".join(path.parent.relative_to(ROOT).parts)


# What counts of it --------------------------------------------------------------------------------


@cache
def _text(node: Node) -> str:
    imports = (ast.Import, ast.ImportFrom)
    return "\n".join(_canonical(s) for s in _statements(node) if not isinstance(s, imports))


def _canonical(node: object) -> str:
    """A syntax tree as text, without docstrings, alike in all versions of Python."""
    if isinstance(node, list):
        said = [child for child in node if not _is_text(child)]
        return f"[{','.join(map(_canonical, said))}]" if said else ""
    if not isinstance(node, ast.AST):
        return "" if node is None else repr(node)
    fields = ((name, _canonical(value)) for name, value in ast.iter_fields(node))
    told = ",".join(f"{name}={text}" for name, text in fields if text and name != "ctx")
    return f"{type(node).__name__}({told})"


def _is_text(statement: object) -> bool:
    return (
        isinstance(statement, ast.Expr)
        and isinstance(statement.value, ast.Constant)
        and isinstance(statement.value.value, str)
    )


@cache
def _assets(node: Node) -> frozenset[Path]:
    """The files beside a module, or in a folder there, that its code names."""
    constants = (
        inner.value
        for statement in _statements(node)
        for inner in ast.walk(statement)
        if isinstance(inner, ast.Constant) and isinstance(inner.value, str)
    )
    names = {text for text in constants if _ASSET.fullmatch(text)}
    return frozenset(path for name in names for path in node.path.parent.glob(f"**/{name}"))


def _hashed(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:_LENGTH]
