"""The page of a crossing: what a simulation lacked, and what its policies did on the system."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mcpilco.crossing import Crossing, Outcome
from mcpilco.show.plots.rollouts import plot_promise
from mcpilco.show.report.document import Document, Section, Table, draw, made, write_document


def write_crossing_report(
    path: Path, legs: Mapping[str, Crossing], gap: Mapping[str, Any], about: str
) -> Path:
    """The path of the page written; it holds its pictures and needs no other file.

    Raises:
        RunFolderError: the page cannot be written.
        InputError: matplotlib or jinja2 is missing.
    """
    return write_document(path, page_of(legs, gap, about))


def page_of(legs: Mapping[str, Crossing], gap: Mapping[str, Any], about: str) -> Document:
    """The content of the page of a crossing."""

    def sections() -> Iterator[Section]:
        yield made("What the simulation lacked", _lacked, gap)
        yield made("What was promised and what happened", _outcomes, legs)
        for leg, found in legs.items():
            yield made(f"The {leg} simulation", _episode, leg, found)

    return Document("From the simulation to the system", about, _tiles(legs, gap), sections())


def _tiles(legs: Mapping[str, Crossing], gap: Mapping[str, Any]) -> list[tuple[str, str]]:
    tiles = [("verdict on the simulation", str(gap["verdict"]).replace("_", " "))]
    error = gap.get("error") or {}
    closed = (error.get("closed") or {}).get("value")
    if closed is not None and gap["effects"] and not error.get("hidden"):
        tiles.append(("of the gap is closed", f"{100 * closed:.1f} %"))
    for leg, found in legs.items():
        tiles.append((f"on the system, trained in the {leg} simulation", _short(found.happened)))
    return tiles


def _lacked(gap: Mapping[str, Any]) -> Section:
    rows = [
        (
            effect["name"],
            effect["target"],
            "; ".join(f"{symbol} = {_interval(e)}" for symbol, e in effect["parameters"].items()),
        )
        for effect in gap["effects"]
    ]
    if not rows:
        return Section(
            f"No effect was named; the verdict is “{gap['verdict']}”. More is told in "
            "gap/report.html."
        )
    header = ("effect", "at", "size (95 % interval)")
    text = "Found in the recordings of the system; see gap/report.html."
    return Section(text, tables=[Table(header, rows)])


def _interval(estimate: Mapping[str, Any]) -> str:
    ends = [estimate[name] for name in ("value", "low", "high")]
    value, low, high = ("?" if end is None else f"{end:.4g}" for end in ends)
    return f"{value} {estimate['unit']} ({low} to {high})"


def _outcomes(legs: Mapping[str, Crossing]) -> Section:
    rows = [
        (
            f"in the {leg} simulation",
            str(found.trial),
            _short(found.promised),
            _short(found.happened),
            f"{found.promised.returns:.1f}",
            f"{found.happened.returns:.1f}",
        )
        for leg, found in legs.items()
    ]
    one = next(iter(legs.values()))
    header = ("trained", "trial", "promised", "on the system", "return promised", "return there")
    text = (
        f"Over {one.promised.episodes} fresh episodes in the simulation and "
        f"{one.happened.episodes} on the system. The policy is that of the trial that did best in "
        "its own simulation; the system had no say in it, and was met for the recordings and for "
        "this table alone."
    )
    return Section(text, tables=[Table(header, rows)])


def _short(outcome: Outcome) -> str:
    if outcome.success is None:
        return f"return {outcome.returns:.1f}"
    return f"{100 * outcome.success:.0f} % success"


def _episode(leg: str, found: Crossing) -> Section:
    text = "One episode: as the simulation promised it, and as it was on the system."
    pictures = []
    for k, (name, unit) in enumerate(found.states):
        promised, happened = found.promised.states[:, k], found.happened.states[:, k]
        of = promised, happened, found.dt, f"{name} [{unit}]"
        pictures.append(draw(f"{name} over time, promised and on the system", plot_promise, *of))
    return Section(text, pictures, title=f"Trained in the {leg} simulation", columns=2)
