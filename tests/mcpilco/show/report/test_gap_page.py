from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from mcpilco.gap import Closest, Event, Gap
from mcpilco.gap.comparison import Interval
from mcpilco.show.report import gap_page
from mcpilco.show.report.document import Picture
from mcpilco.show.report.gap_page import write_gap_report
from tests.mcpilco.gap.pushed import PUSH_S
from tests.mcpilco.show import browser
from tests.mcpilco.show.report.test_page import Reader

_DOT = "data:image/svg+xml;base64,PHN2Zy8+"


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """One dot in place of each picture."""
    monkeypatch.setattr(gap_page, "draw", lambda says, *_, **__: Picture(_DOT, says))


def read(gap: Gap, folder: Path) -> Reader:
    return Reader(write_gap_report(gap, folder / "report.html").read_text(encoding="utf-8"))


def test_page_tells_everything_in_one_file(found: Gap, tmp_path: Path) -> None:
    left_out = Event(found.recordings[1].name, *PUSH_S)
    page = read(replace(found, events=(left_out,)), tmp_path)
    assert page.headings == [
        "What to mind",
        "What is missing",
        "What adding it is worth",
        "The force that is missing",
        "When they disagree",
        "Held-out windows",
        "What was compared",
        "Recordings",
    ]
    assert all(address.startswith("data:image/svg+xml;base64,") for address in page.addresses)
    # growth and shrink; three profiles and a map; one channel of two plants; three windows
    assert len(page.images) == 2 + 4 + 2 + 3
    assert all(image["alt"] for image in page.images)
    series = [image["alt"] for image in page.images[-3:]]
    assert all(f"angle in {found.held_out[0]}, from" in says for says in series)
    assert any("over torque [N m]" in image["alt"] for image in page.images)
    assert "refitted" in page.text
    assert "all, with what was left out [noise std]" in page.text
    assert "all [noise std]" in read(found, tmp_path).text
    friction = found.named[0]
    assert f"{friction.parameters['f_c'].value:.4g} N m" in page.text
    for name in (*found.train, *found.held_out):
        assert name in page.text
    assert "Left out of recording_1, as no model explains it: 4.0 to 4.7 s." in page.text


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("command", [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
def test_columns_that_never_change_are_drawn_without_a_warning(
    found: Gap, tmp_path: Path, command: float
) -> None:
    still = tuple(
        replace(one, inputs=np.full_like(one.inputs, command), states=0.0 * one.states)
        for one in found.recordings
    )
    page = read(replace(found, recordings=still), tmp_path)
    assert len(page.images) == 11
    assert "cannot be shown" not in page.text


@pytest.mark.usefixtures("undrawn")
def test_page_of_too_little_says_what_to_record(found: Gap, tmp_path: Path) -> None:
    poor = replace(
        found,
        verdict="too_poor",
        named=(),
        comparison=None,
        models=None,
        search=None,
        events=(),
        experiments=("Record longer.",),
    )
    page = read(poor, tmp_path)
    assert page.headings == ["What to record next", "Recordings"]
    assert "Record longer." in page.text


@pytest.mark.usefixtures("undrawn")
def test_page_of_a_plant_that_lacks_nothing_speaks_of_no_correction(
    found: Gap, tmp_path: Path
) -> None:
    assert found.models is not None
    models = replace(found.models, corrected=found.models.refit)
    none = replace(found, verdict="none", named=(), models=models, corrected=found.plant)
    page = read(none, tmp_path)
    assert page.headings[:2] == ["Errors on held-out recordings", "The force that is left over"]
    assert "of the gap is closed" not in page.text
    assert not any("corrected" in image["alt"] for image in page.images)


@pytest.mark.usefixtures("undrawn")
def test_page_of_something_unknown_says_where_to_look(found: Gap, tmp_path: Path) -> None:
    closest = Closest(found.named, Interval(0.78, -0.09, 0.96), found.corrected)
    page = read(replace(found, verdict="unknown", named=(), closest=closest), tmp_path)
    assert page.headings[:2] == ["What to mind", "What comes closest"]
    assert "when the residual is large" in page.text
    assert "78.0 % (-9.0 to 96.0)" in page.text


@pytest.mark.usefixtures("undrawn")
def test_errors_of_recordings_that_were_fitted_are_called_that(
    found: Gap,
    tmp_path: Path,
) -> None:
    page = read(replace(found, held_out=()), tmp_path)
    assert "which were fitted too" in page.text
    assert "record three or more" in page.text


@pytest.mark.usefixtures("undrawn")
def test_text_of_a_recording_cannot_become_markup(found: Gap, tmp_path: Path) -> None:
    odd = replace(found.recordings[0], remarks=("<script>alert(1)</script>",))
    write_gap_report(
        replace(found, recordings=(odd, *found.recordings[1:])), tmp_path / "page.html"
    )
    assert "<script" not in (tmp_path / "page.html").read_text()


@pytest.mark.slow
@pytest.mark.skipif(browser.CHROMIUM is None, reason="no chromium; apt-get install chromium")
@pytest.mark.parametrize("width", [390, 1200])
def test_browser_shows_the_page_within_its_width(found: Gap, tmp_path: Path, width: int) -> None:
    path = write_gap_report(found, tmp_path / "report.html")
    with browser.page(tmp_path / "profile") as page:
        page.open(f"file://{path}", width, 800)
        page.wait_for("document.readyState == 'complete'")
        assert page.ask("document.documentElement.scrollWidth") <= width
        assert page.ask("[...document.images].every(i => i.complete && i.naturalWidth > 100)")
        assert page.problems == []
