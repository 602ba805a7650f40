"""Write a reference page for each room into docs/reference/, from the names that it lists.

`make docs` runs this before it builds the site. On a page stand the docstring of the room and those
of its public names, module by module; the packages inside it that list names of their own follow.
"""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGES = ROOT / "docs" / "reference"
TOPS = ("mcpilco", "envs", "baselines")


def rooms() -> list[str]:
    """The dotted names of the packages that get a page: the tops and what stands directly in them.

    Rooms of `mcpilco` and `baselines` have a page each, and so has each top for its own names.
    """
    inner = [
        f"{top}.{folder.name}"
        for top in ("mcpilco", "baselines")
        for folder in sorted((ROOT / top).iterdir())
        if (folder / "__init__.py").exists()
    ]
    return [room for room in [*TOPS, *inner] if public_names(room)]


def folder_of(room: str) -> Path:
    """The folder of a package."""
    return ROOT.joinpath(*room.split("."))


def source_of(module: str) -> Path:
    """The file that binds a module's names: a package's stub where it has one."""
    path = folder_of(module)
    files = (path / "__init__.pyi", path / "__init__.py", path.with_suffix(".py"))
    return next(file for file in files if file.exists())


def imports_of(module: str) -> dict[str, tuple[str, str]]:
    """Where the names that a module imports from a module come from: module and name there."""
    file = source_of(module)
    package = module if file.stem == "__init__" else module.rpartition(".")[0]
    found = {}
    for statement in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(statement, ast.ImportFrom):
            parts = package.split(".")[: 1 - statement.level or None] if statement.level else []
            origin = ".".join([*parts, *([statement.module] if statement.module else [])])
            found |= {name.asname or name.name: (origin, name.name) for name in statement.names}
    return found


def definition_of(module: str, name: str) -> str:
    """The dotted name under which an object is defined, however often it is imported on the way."""
    while name in (imported := imports_of(module)) and imported[name][0].split(".")[0] in TOPS:
        if imported[name] == (module, name):  # a submodule
            break
        module, name = imported[name]
    return f"{module}.{name}"


def defines(module: str, name: str) -> bool:
    """Whether a statement of its own in the module defines the name: not one of several at once."""
    for node in ast.parse(source_of(module).read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return True
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if any(isinstance(target, ast.Name) and target.id == name for target in targets):
            return True
    return False


def public_names(room: str) -> list[str]:
    """The names in `__all__`, those of one module side by side; submodules are left out."""
    tree = ast.parse(source_of(room).read_text(encoding="utf-8"))
    listed: list[str] = []
    for statement in tree.body:
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "__all__":
            listed = [ast.literal_eval(name) for name in getattr(statement.value, "elts", ())]
    imported = imports_of(room)
    submodules = {name for name in listed if imported.get(name, ("",))[0] == room}
    order = {name: number for number, name in enumerate(imported)}
    return sorted(set(listed) - submodules, key=lambda name: (order.get(name, -1), name))


def subrooms(room: str) -> list[str]:
    """The packages below a room that list names which the room does not list itself."""
    if room in ("mcpilco", "baselines"):
        return []  # theirs have pages
    inits = sorted(folder_of(room).glob("**/__init__.py"))
    below = [".".join(init.parent.relative_to(ROOT).parts) for init in inits]
    own = set(public_names(room))
    return [name for name in below if name != room and set(public_names(name)) - own]


def section(room: str, names: list[str]) -> list[str]:
    """Directives of mkdocstrings: the docstring of the package, then its names.

    Names that are bound several at once have no docstring of their own, and no entry.
    """
    homes = [definition_of(room, name) for name in names]
    entries = [home for home in homes if defines(*home.rsplit(".", 1))]
    head = f"::: {room}\n    options:\n      show_root_heading: false\n      members: false\n"
    return [head, *(f"::: {home}\n" for home in entries)]


def page(room: str) -> str:
    """The Markdown of a room's page."""
    parts = [f"# {room}\n", *section(room, public_names(room))]
    seen = set(public_names(room))
    for inner in subrooms(room):
        names = [name for name in public_names(inner) if name not in seen]
        seen.update(names)
        parts += [f"---\n\n`{inner}`\n", *section(inner, names)] if names else []
    return "\n".join(parts)


def main() -> None:
    """Write the pages, and remove those of rooms that are gone."""
    PAGES.mkdir(exist_ok=True)
    pages = {f"{room}.md": page(room) for room in rooms()}
    for old in PAGES.glob("*.md"):
        if old.name not in pages:
            old.unlink()
    for name, text in pages.items():
        (PAGES / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
