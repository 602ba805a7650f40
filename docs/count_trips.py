"""Count the five trips through the house, and write them into docs/map.md.

    python docs/count_trips.py            # prints the tables
    python docs/count_trips.py --write    # puts them into the page

A trip is a list of stops, in the order in which a stranger opens them. A stop is a file, or a few
definitions of it; its lines are counted here, so that the page cannot claim another number.
"""

from __future__ import annotations

import ast
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "map.md"


@dataclass(frozen=True)
class Stop:
    """A file on the way, and what is found there."""

    path: str
    """from the root of the repository"""
    finds: str
    """what a reader looks for"""
    names: tuple[str, ...] = ()
    """the definitions to read; none: the whole file"""
    edit: bool = False
    """it is changed, too"""
    read: bool = True
    """it is read; a line in a list that is edited needs no reading"""

    @property
    def lines(self) -> int:
        """The lines to read."""
        text = (ROOT / self.path).read_text(encoding="utf-8")
        if not self.names:
            return len(text.splitlines())
        spans = definitions(text)
        return sum(spans[name] for name in self.names)


def definitions(text: str) -> dict[str, int]:
    """The lines of each class, function and method (`Class.method`), decorators included."""
    found = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found[node.name] = _lines(node)
        if isinstance(node, ast.ClassDef):
            methods = [member for member in node.body if isinstance(member, ast.FunctionDef)]
            found |= {f"{node.name}.{method.name}": _lines(method) for method in methods}
    return found


def _lines(node: ast.ClassDef | ast.FunctionDef) -> int:
    first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
    return (node.end_lineno or node.lineno) - first + 1


@dataclass(frozen=True)
class Trip:
    """A way that must be short, and how long it may be."""

    title: str
    stops: tuple[Stop, ...]
    files: int
    """that may be read at most"""
    edits: int | None = None
    """files that may be changed at most; none: nothing is changed"""
    lines: int | None = None
    """that may be read at most"""
    hops: tuple[str, ...] = ()
    """calls from the first line to the aim, one after another"""
    most_hops: int | None = None

    @property
    def read(self) -> list[Stop]:
        """The stops that are read, a file counted once."""
        return [stop for stop in self.stops if stop.read]

    @property
    def total(self) -> int:
        """All lines to read."""
        return sum(stop.lines for stop in self.read)

    @property
    def files_read(self) -> int:
        return len({stop.path for stop in self.read})

    @property
    def files_edited(self) -> int:
        return len({stop.path for stop in self.stops if stop.edit})


TRIPS = ()


def summary(trip: Trip) -> str:
    """A trip's numbers in a sentence."""
    parts = [f"{trip.files_read} files to read, {trip.total:,} lines"]
    if trip.edits is not None:
        parts.append(f"{trip.files_edited} to edit")
    if trip.most_hops is not None:
        parts.append(f"{len(trip.hops)} hops")
    return "; ".join(parts)


def table(trip: Trip) -> str:
    """A trip as a section of the page."""
    rows = [f"### {trip.title}", "", f"{summary(trip)}.", ""]
    if trip.hops:
        rows += ["The hops: " + " → ".join(f"`{hop}`" for hop in trip.hops) + ".", ""]
    rows += ["| | open | lines | to see |", "|---|---|---|---|"]
    for number, stop in enumerate(trip.stops, 1):
        do = "edit" if stop.edit else "read"
        where = f"`{stop.path}`" + (
            f": {', '.join(f'`{n}`' for n in stop.names)}" if stop.names else ""
        )
        rows.append(
            f"| {number} {do} | {where} | {stop.lines if stop.read else ''} | {stop.finds} |"
        )
    return "\n".join(rows)


START, END = "<!-- trips: written by docs/count_trips.py -->\n", "<!-- end of trips -->"


def written(page: str) -> str:
    """The page with the tables as they are now."""
    head, _, rest = page.partition(START)
    return (
        head + START + "\n" + "\n\n".join(map(table, TRIPS)) + "\n\n" + END + rest.partition(END)[2]
    )


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print("\n\n".join(map(table, TRIPS)))
