"""The page of a run: everything that its folder tells, in one HTML file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from mcpilco.logbook import History, RunFolder, read_history
from mcpilco.show.report import document, sections
from mcpilco.show.report.document import Document, Section, made


def write_report(run: RunFolder, out: Path | None = None) -> Path:
    """The path of the page written; it holds its pictures and needs no other file.

    Args:
        run: what it tells of. What cannot be read of it is named in the page.
        out: where it goes; `report.html` in the run folder when None.

    Raises:
        RunFolderError: nothing can be read, or the page cannot be written.
        InputError: matplotlib or jinja2 is missing.
    """
    document.require_extra()
    history = read_history(run)
    path = run.path / "report.html" if out is None else out
    return document.write_document(path, page_of(history))


def page_of(history: History) -> Document:
    """The content of the page of a run."""
    config = history.run.config
    return Document(
        title=f"{config['env']}, {_setting(config)}, seed {config['seed']}",
        about=history.run.path.resolve().name,
        tiles=_tiles(history),
        sections=_sections(history),
        cautions=sections.failures(history),
    )


def _setting(config: Mapping[str, Any]) -> str:
    """The preset, after the algorithm where that is another than the package's own."""
    algo = config.get("algo", "mcpilco")
    return config["preset"] if algo == "mcpilco" else f"{algo} {config['preset']}"


def _sections(history: History) -> Iterator[Section]:
    """All sections; one that cannot be made says why."""
    learned = history.learned
    if learned:
        yield made("Learning", partial(sections.learning, history))
        last = learned[-1]
        yield made("Last trial", partial(sections.rollout, history, last, False))
        if history.foreseen:
            yield made("How far the predictions hold", partial(sections.errors, history))
            yield made("Calibration", partial(sections.calibration, history))
            yield made("Policy", partial(sections.policy, history))
        yield made("Policy search", partial(sections.search, history))
        yield made("Timings", partial(sections.timings, history))
    for trial in history.trials:
        if not learned or trial is not learned[-1]:
            title, fold = f"Trial {trial.number}", bool(learned)
            yield made(title, partial(sections.rollout, history, trial, fold))
    yield made("Configuration", partial(sections.configuration, history))


def _tiles(history: History) -> list[tuple[str, str]]:
    """The numbers that one looks for first: a heading and a value each."""
    learned = history.learned
    if not learned:
        return [("trials", "none yet")]
    last = learned[-1]
    won = [trial for trial in learned if trial.success]
    tiles = [("trials", f"{len(learned)} of {history.run.config['trials']}")]
    if any(trial.success is not None for trial in learned):
        first = f"after {won[0].experience_s:g} s" if won else "not yet"
        tiles.append(("first success", first))
        tiles.append(("successes", f"{len(won)} of {len(learned)}"))
    if history.foreseen:
        tiles.append(("last cost, predicted", f"{last.predicted_cost:.2f}"))
    tiles.append(("last cost, real", f"{last.real_cost:.2f}"))
    tiles.append(("time of the trials", f"{sum(t.row['wall_s'] for t in learned):.0f} s"))
    return tiles
