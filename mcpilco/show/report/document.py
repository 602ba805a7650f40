"""A page in one HTML file: sections with figures and tables, how it looks, how it is written."""

from __future__ import annotations

import base64
import contextlib
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcpilco.files import write_bytes
from mcpilco.typing import InputError, McPilcoError

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_INCHES = (4.4, 2.8)
_MARGINS = {"left": 0.15, "right": 0.97, "bottom": 0.17, "top": 0.96}
"""room for labels, in parts of the picture; matplotlib's own layouts draw each one several times"""
_PAD = 0.03
"""room around labels beside a colour bar [inch]"""
_DPI = 110
"""of what a picture holds as pixels"""


@dataclass(frozen=True)
class Picture:
    """A plot as part of a page."""

    source: str
    """an SVG as data URI"""
    says: str
    """what it shows, for those who cannot see it"""


@dataclass(frozen=True)
class Table:
    """Rows of text under a header."""

    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


@dataclass(frozen=True)
class Section:
    """One part of a page."""

    text: str = ""
    pictures: Sequence[Picture] = ()
    tables: Sequence[Table] = ()
    title: str = ""
    """empty: that of the page's list of sections"""
    key: bool = False
    """explain the colours of a rollout"""
    columns: int = 0
    """pictures beside one another, where the page is wide enough; 0: as many as fit"""
    folded: bool = False
    """show the title only, until it is clicked"""


def _keep_inside(figure: Figure) -> None:
    """Narrow the axes of a figure until their labels, and those of a colour bar, are within it."""
    width, height = figure.get_size_inches()
    for _ in range(2):  # a bar that is narrower itself stands a little further out
        drawn, margins = figure.get_tightbbox().padded(_PAD), figure.subplotpars
        figure.subplots_adjust(
            left=margins.left + max(0.0, -drawn.x0 / width),
            right=margins.right - max(0.0, drawn.x1 / width - 1.0),
            bottom=margins.bottom + max(0.0, -drawn.y0 / height),
            top=margins.top - max(0.0, drawn.y1 / height - 1.0),
        )


def draw(says: str, plot: Callable[..., object], *of: object, **margins: float) -> Picture:
    """The picture that a function draws of something on new axes, which come last.

    Equal drawings make equal pictures. The margins are where left, right, bottom and top of the
    axes are, in parts of the picture, where labels need more room than usual.

    Raises:
        InputError: matplotlib cannot draw the values, which is so where they are beyond all scales.
    """
    import matplotlib
    from matplotlib.figure import Figure

    settings: Any = {
        "font.size": 9,
        "svg.fonttype": "none",
        "svg.hashsalt": "mcpilco",
        "text.parse_math": False,  # a state's name is no formula
    }
    with matplotlib.rc_context(settings):
        figure = Figure(figsize=_INCHES)
        figure.subplots_adjust(**{**_MARGINS, **margins})
        ax = figure.subplots()
        ax.spines[["top", "right"]].set_visible(False)
        content = io.BytesIO()
        try:
            plot(*of, ax)
            if len(figure.axes) > 1:
                _keep_inside(figure)
            figure.savefig(content, format="svg", dpi=_DPI, metadata={"Date": None})
        except (ValueError, OverflowError) as error:
            raise InputError(f"{says}: the values cannot be drawn ({error}).") from error
    code = base64.b64encode(content.getvalue()).decode()
    return Picture(f"data:image/svg+xml;base64,{code}", says)


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
    return template.render({**vars(document), "sections": list(document.sections)})


def write_document(path: Path, document: Document) -> Path:
    """The path of the page written, whole or not at all; it needs no other file.

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
    page = render(document).encode()
    with contextlib.suppress(OSError):  # the writing then says what is wrong
        path.parent.mkdir(parents=True, exist_ok=True)
    return write_bytes(path, page)


def made(title: str, make: Callable[..., Section], *of: object) -> Section:
    """A section, under this title where it names no other; one that cannot be made says why."""
    try:
        section = make(*of)
    except McPilcoError as error:
        section = Section(f"This cannot be shown. {error}")
    return section if section.title else replace(section, title=title)
