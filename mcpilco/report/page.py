"""The page: everything that a run folder tells, in one HTML file."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from mcpilco.archive import write_bytes
from mcpilco.history import History, read_history
from mcpilco.report import sections
from mcpilco.report.parts import Section
from mcpilco.run_folder import RunFolder
from mcpilco.typing import InputError, McPilcoError

_TEMPLATE = Path(__file__).parent / "page.html.j2"


def write_report(run: RunFolder, out: Path | None = None) -> Path:
    """The path of the page written; it holds its pictures and needs no other file.

    Args:
        run: what it tells of. What cannot be read of it is named in the page.
        out: where it goes; `report.html` in the run folder when None.

    Raises:
        RunFolderError: nothing can be read, or the page cannot be written.
        InputError: matplotlib or jinja2 is missing.
    """
    _require_extra()
    history = read_history(run)
    path = run.path / "report.html" if out is None else out
    page = render(history).encode()
    with contextlib.suppress(OSError):  # the writing then says what is wrong
        path.parent.mkdir(parents=True, exist_ok=True)
    return write_bytes(path, page)


def render(history: History) -> str:
    """The page's text."""
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))
    made = list(_sections(history))
    config = history.run.config
    return template.render(
        title=f"{config['env']}, {_setting(config)}, seed {config['seed']}",
        folder=history.run.path.resolve().name,
        tiles=_tiles(history),
        failures=sections.failures(history),
        sections=made,
    )


def _setting(config: Mapping[str, Any]) -> str:
    """The preset, after the algorithm where that is another than the package's own."""
    algo = config.get("algo", "mcpilco")
    return config["preset"] if algo == "mcpilco" else f"{algo} {config['preset']}"


def _sections(history: History) -> Iterator[Section]:
    """All sections; one that cannot be made says why."""
    learned = history.learned
    if learned:
        yield _made("Learning", partial(sections.learning, history))
        last = learned[-1]
        yield _made("Last trial", partial(sections.rollout, history, last, False))
        yield _made("How far the predictions hold", partial(sections.errors, history))
        yield _made("Calibration", partial(sections.calibration, history))
        yield _made("Policy", partial(sections.policy, history))
        yield _made("Policy search", partial(sections.search, history))
        yield _made("Timings", partial(sections.timings, history))
    for trial in history.trials:
        if not learned or trial is not learned[-1]:
            title, fold = f"Trial {trial.number}", bool(learned)
            yield _made(title, partial(sections.rollout, history, trial, fold))
    yield _made("Configuration", partial(sections.configuration, history))


def _made(title: str, make: Callable[[], Section]) -> Section:
    try:
        return make()
    except McPilcoError as error:
        return Section(title, f"This cannot be shown. {error}")


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
    tiles.append(("last cost, predicted", f"{last.predicted_cost:.2f}"))
    tiles.append(("last cost, real", f"{last.real_cost:.2f}"))
    tiles.append(("time of the trials", f"{sum(t.row['wall_s'] for t in learned):.0f} s"))
    return tiles


def _require_extra() -> None:
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"A report needs {error.name}; install it with: pip install 'mcpilco[report]'"
        ) from error
