"""The page of a gap: what a plant lacks, how that shows, and what adding it is worth."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from mcpilco.gap import Gap, cautions, three_digits, verdict_sentence
from mcpilco.show.report import document
from mcpilco.show.report import gap_sections as sections
from mcpilco.show.report.document import Document, made
from mcpilco.show.report.parts import Section


def write_gap_report(gap: Gap, path: Path) -> Path:
    """The path of the page written; it holds its pictures and needs no other file.

    Args:
        gap: of which it tells.
        path: where it goes.

    Raises:
        RunFolderError: the page cannot be written.
        InputError: matplotlib or jinja2 is missing.
    """
    document.require_extra()
    return document.write(path, page_of(gap))


def page_of(gap: Gap) -> Document:
    """The content of the page of a gap."""
    return Document(
        title=f"{gap.plant.name}: {verdict_sentence(gap).rstrip('.')}",
        about=f"simulation against {len({*gap.train, *gap.held_out})} recordings",
        tiles=_tiles(gap),
        sections=_sections(gap),
        cautions=cautions(gap),
        cautions_title="What to mind",
    )


def _tiles(gap: Gap) -> list[tuple[str, str]]:
    """The numbers that one looks for first: a heading and a value each."""
    tiles = [("verdict", gap.verdict.replace("_", " "))]
    found = gap.comparison
    if found is None:
        return tiles
    if gap.mended and not found.hidden:
        closed = found.closed
        ends = f"({100 * closed.low:.1f} to {100 * closed.high:.1f} %)"
        tiles.append((f"of the gap is closed {ends}", f"{100 * closed.value:.1f} %"))
    after = f"after {found.horizon_s:g} s, in noise std"
    tiles.append((f"nominal error {after}", three_digits(found.nominal)))
    name = "corrected" if gap.mended else "refitted"
    tiles.append((f"{name} error {after}", three_digits(found.corrected)))
    tiles.append(("what noise alone does", three_digits(found.noise_floor)))
    return tiles


def _sections(gap: Gap) -> Iterator[Section]:
    """All sections; one that cannot be made says why."""
    if gap.named:
        yield made("What is missing", partial(sections.effects, gap))
    if gap.corrected.learned:
        yield made("What was learned", partial(sections.learned, gap))
    if gap.comparison is not None:
        yield made("Errors on held-out recordings", partial(sections.worth, gap, gap.comparison))
    if gap.models is not None:
        yield made("The force that is left over", partial(sections.force, gap, gap.models))
        yield made("When they disagree", partial(sections.when, gap, gap.models))
    if gap.comparison is not None:
        yield made("Held-out windows", partial(sections.windows, gap, gap.comparison))
    if gap.experiments:
        yield made("What to record next", partial(sections.experiments, gap))
    if gap.search is not None:
        yield made("What was compared", partial(sections.candidates, gap, gap.search))
    if gap.recordings:
        yield made("Recordings", partial(sections.recordings, gap))
