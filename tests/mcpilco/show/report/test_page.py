from __future__ import annotations

import base64
import builtins
import shutil
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest

pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

from mcpilco.logbook import RunFolder, read_history
from mcpilco.show.report import learned, page, write_report
from mcpilco.show.report.document import Picture, render
from mcpilco.show.report.page import page_of
from mcpilco.sweep.robustness import FACTORS, Direction
from mcpilco.typing import InputError, RunFolderError
from tests.mcpilco.show import browser

_DOT = "data:image/svg+xml;base64,PHN2Zy8+"
_VOID = {"meta", "img", "br", "link", "input"}


class Reader(HTMLParser):
    """Headings, pictures and all addresses of a page; notes tags that are not closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.headings: list[str] = []
        self.images: list[dict] = []
        self.addresses: list[str] = []
        self.text = ""
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.addresses += [values[name] for name in ("src", "href") if name in values]
        if tag == "img":
            self.images.append(values)
        if tag not in _VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data
        if self.open and self.open[-1] in ("h2", "summary"):
            self.headings.append(data)


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """One dot in place of each picture, one direction: they take most of a page's time."""
    direction = Direction("mass", 1.0, "kg", (1.0,) * len(FACTORS))
    monkeypatch.setattr(page, "draw", lambda says, *_: Picture(_DOT, says))
    monkeypatch.setattr(learned, "directions", lambda *_: [direction])


@pytest.fixture(scope="module")
def whole(made_once, tmp_path_factory) -> Reader:
    """The page of a run in which nothing went wrong, drawn."""
    path = tmp_path_factory.mktemp("page") / "page.html"
    return Reader(write_report(RunFolder.open(made_once), path).read_text(encoding="utf-8"))


def read(run) -> Reader:
    return Reader(write_report(run).read_text(encoding="utf-8"))


def test_page_holds_every_section(whole) -> None:
    headings = whole.headings
    expected = ["Learning", "How far the predictions hold", "Calibration", "Policy"]
    expected += [
        "Where the policy holds",
        "Policy search",
        "Timings",
        "Exploration: the rollout before the first trial",
    ]
    assert [h for h in headings if h in expected] == expected
    assert any(h.startswith("Trial 2, after 1.6 s") for h in headings)
    assert headings[-1] == "Configuration"


def test_page_needs_no_other_file(whole) -> None:
    page = whole
    assert page.addresses
    assert all(address.startswith("data:image/svg+xml;base64,") for address in page.addresses)
    assert "url(" not in page.text
    assert "@import" not in page.text


def test_pictures_are_drawings_that_say_what_they_show(whole) -> None:
    images = whole.images
    # Learning, search, times, two of calibration, two maps, where the policy holds; errors of four
    # states; three rollouts of four states, an input and a cost, but that the exploration has no
    # prediction.
    assert len(images) == 3 + 2 + 2 + 1 + 4 + 3 * 6
    for image in images:
        assert image["alt"]
        drawing = ElementTree.fromstring(base64.b64decode(image["src"].split(",")[1]))
        assert drawing.tag.endswith("svg")
        assert list(drawing.iter("{http://www.w3.org/2000/svg}path"))


def test_trials_are_told_with_their_costs(undrawn, run) -> None:
    text = read(run).text
    for row in run.metrics():
        assert f"{row['real_cost']:.2f}" in text
        assert f"{row['predicted_cost']:.2f}" in text


def test_run_that_was_interrupted_says_so(undrawn, run) -> None:
    (run.path / "summary.json").unlink()
    assert "The run has not ended: 2 of 2 trials are there." in read(run).text


def test_run_of_one_trial_is_told(undrawn, run) -> None:
    path = run.path / "metrics.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:2]))
    page = read(run)
    assert any(h.startswith("Trial 1, after 0.8 s") for h in page.headings)
    assert "Calibration" in page.headings


def test_run_without_a_trial_shows_its_exploration(undrawn, run) -> None:
    path = run.path / "metrics.csv"
    path.write_text(path.read_text().splitlines(keepends=True)[0])
    page = read(run)
    assert page.headings == [
        "What went wrong",
        "Exploration: the rollout before the first trial",
        "Configuration",
    ]
    assert len(page.images) == 6


def test_run_in_which_nothing_was_measured_is_refused(undrawn, run, tmp_path) -> None:
    new = RunFolder.create(tmp_path / "new", run.config)
    with pytest.raises(RunFolderError, match="neither task.json nor agent.npz"):
        write_report(new)


def test_folder_of_an_earlier_version_is_told_but_for_the_real_cost(undrawn, run) -> None:
    (run.path / "task.json").unlink()  # the agent's file knows the task as well
    for number in (0, 1, 2):
        arrays = run.read_arrays(number, "rollout")
        arrays.pop("costs")
        run.write_arrays(number, "rollout", arrays)
    page = read(run)
    assert "Calibration" in page.headings
    assert len(page.images) == 29  # the exploration's cost is not known


@pytest.mark.parametrize(
    ("name", "lost"),
    [
        ("trials/02/gp.npz", "Calibration"),
        pytest.param("trials/01/transitions.npz", "Calibration", marks=pytest.mark.slow),
        ("trials/02/policy.npz", "Policy"),
        ("policy_steps.jsonl", "Policy search"),
    ],
)
def test_part_that_is_gone_is_named_where_it_is_missed(undrawn, run, name, lost) -> None:
    (run.path / name).unlink()
    page = read(run)
    assert lost in page.headings
    after = page.text[page.text.index(f"\n{lost}\n") if f"\n{lost}\n" in page.text else 0 :]
    assert "This cannot be shown." in after
    assert name in page.text


@pytest.mark.parametrize(
    "name",
    [
        "metrics.csv",
        pytest.param("summary.json", marks=pytest.mark.slow),
        "trials/01/particles.npz",
    ],
)
def test_damaged_file_is_named_among_what_went_wrong(undrawn, run, name) -> None:
    (run.path / name).write_bytes(b"\x00nothing of use")
    page = read(run)
    assert "What went wrong" in page.headings
    assert name in page.text


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*:RuntimeWarning")
def test_rollout_that_exploded_is_told_all_the_same(run) -> None:
    for name in ("particles", "rollout"):
        arrays = run.read_arrays(2, name)
        for key in ("states", "costs"):
            arrays[key][3], arrays[key][4], arrays[key][5:] = float("nan"), float("inf"), 1e308
        run.write_arrays(2, name, arrays)
    headings = read(run).headings
    assert "Learning" in headings
    assert headings[-1] == "Configuration"


def test_text_of_a_run_cannot_become_markup(undrawn, run) -> None:
    config = {**run.config, "env": "<script>alert(1)</script>"}
    text = render(page_of(read_history(RunFolder(run.path, config))))
    assert "<script" not in text
    Reader(text)


def test_missing_extra_is_named(undrawn, run, monkeypatch) -> None:
    real = builtins.__import__

    def without_jinja(name, *args, **kwargs):
        if name.startswith("jinja2"):
            raise ImportError(name, name=name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_jinja)
    with pytest.raises(InputError, match=r"needs jinja2; install it with: .*mcpilco\[report\]"):
        write_report(run)


@pytest.mark.slow
@pytest.mark.skipif(browser.CHROMIUM is None, reason="no chromium; apt-get install chromium")
@pytest.mark.parametrize("width", [390, 1200])
def test_browser_shows_the_page_alone_and_within_its_width(run, tmp_path, width) -> None:
    path = shutil.copy(write_report(run), tmp_path / "page.html")
    with browser.page(tmp_path / "profile") as page:
        page.open(f"file://{path}", width, 800)
        page.wait_for("document.readyState == 'complete'")
        assert page.ask("document.documentElement.scrollWidth") <= width
        boxes = (
            "[...document.querySelectorAll('.scroll')].map(box => [box.scrollWidth > "
            "box.clientWidth, getComputedStyle(box, '::before').content.includes('scroll')])"
        )
        page.wait_for(f"{boxes}.every(([wide, said]) => wide == said)")
        assert any(wide for wide, _ in page.ask(boxes)) == (width == 390)
        drawn = "[...document.images].every(i => i.complete && i.naturalWidth > 100)"
        assert page.ask(drawn)
        assert page.problems == []
        asked = {address.partition(":")[0] for address in page.requests}
        assert asked == {"file", "data"}


def test_a_page_in_a_run_folder_is_written_there_and_nowhere_else(undrawn, made_once, tmp_path):
    """A link in a folder that somebody sent is refused; one that the user names is followed."""
    folder, mine = tmp_path / "run", tmp_path / "mine"
    shutil.copytree(made_once, folder)
    mine.write_text("mine")
    (folder / "report.html").unlink(missing_ok=True)
    (folder / "report.html").symlink_to(mine)
    run = RunFolder.open(folder)
    with pytest.raises(RunFolderError, match="report.html is a link to .*mine, outside"):
        write_report(run)
    assert mine.read_text() == "mine"
    write_report(run, folder / "report.html")
    assert mine.read_text().startswith("<!")
    assert (folder / "report.html").is_symlink()
