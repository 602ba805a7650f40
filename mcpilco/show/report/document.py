"""A page in one HTML file, of whatever sections it is made: how it looks, and how it is written."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mcpilco.files import write_bytes
from mcpilco.show.report.parts import Section
from mcpilco.typing import InputError, McPilcoError

_TEMPLATE = Path(__file__).parent / "page.html.j2"


@dataclass(frozen=True)
class Document:
    """The content of a page."""

    title: str
    about: str
    """a line below the title: of what it tells"""
    tiles: Sequence[tuple[str, str]]
    """the numbers that one looks for first: a heading and a value each"""
    sections: Iterable[Section]
    cautions: Sequence[str] = ()
    """sentences that a reader must not miss"""
    cautions_title: str = "What went wrong"


def render(document: Document) -> str:
    """The page's text."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))
    return template.render(
        title=document.title,
        about=document.about,
        tiles=document.tiles,
        cautions=document.cautions,
        cautions_title=document.cautions_title,
        sections=list(document.sections),
    )


def write(path: Path, document: Document) -> Path:
    """The path of the page written, whole or not at all; it needs no other file.

    Raises:
        RunFolderError: it cannot be written.
    """
    page = render(document).encode()
    with contextlib.suppress(OSError):  # the writing then says what is wrong
        path.parent.mkdir(parents=True, exist_ok=True)
    return write_bytes(path, page)


def made(title: str, make: Callable[[], Section]) -> Section:
    """A section; one that cannot be made says why."""
    try:
        return make()
    except McPilcoError as error:
        return Section(title, f"This cannot be shown. {error}")


def require_extra() -> None:
    """Nothing, where the packages that draw a page are there.

    Raises:
        InputError: matplotlib or jinja2 is missing.
    """
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"A report needs {error.name}; install it with: pip install 'mcpilco[report]'"
        ) from error
