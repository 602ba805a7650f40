from __future__ import annotations

import base64
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.figure import Figure

from mcpilco.show.plots.training import PolicyMap, plot_policy
from mcpilco.show.report.document import Document, Section, Table, draw, write_document
from mcpilco.typing import InputError
from tests.mcpilco.show import browser


def test_equal_drawings_make_equal_pictures_and_others_do_not() -> None:
    first, again, other = (
        draw("a line", lambda ax, height=height: ax.plot([0, 1], [0, height]))
        for height in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_picture_holds_its_text_as_text_and_no_date() -> None:
    picture = draw("a label", lambda ax: ax.set(xlabel="time [s]"))
    drawing = base64.b64decode(picture.source.split(",")[1]).decode()
    assert ">time [s]<" in drawing
    assert "<dc:date>" not in drawing


def test_labels_of_a_colour_bar_are_within_the_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last number and the title of the bar were cut off on the right."""
    policy = PolicyMap(
        x=np.linspace(-1, 1, 5),
        y=np.linspace(-2, 2, 4),
        values=np.zeros((4, 5)),
        path=np.array([[0.0, 0.0], [0.5, 1.0]]),
        low=-1000.0,
        high=1000.0,
        labels=("angle [rad]", "velocity [rad/s]", "torque [N m]"),
    )
    saved, save = [], Figure.savefig

    def note(figure: Figure, *how: Any, **more: Any) -> None:
        box, size = figure.get_tightbbox(), figure.get_size_inches()
        saved.append((box.x0, box.y0, box.x1 - size[0], box.y1 - size[1]))
        save(figure, *how, **more)

    monkeypatch.setattr(Figure, "savefig", note)
    draw("a policy", partial(plot_policy, policy))
    ((left, bottom, right, top),) = saved
    assert min(left, bottom) > 0.0
    assert max(right, top) < 0.0


WORDS = "a formula of many words that nobody can write in a few letters, and some more of it"


@pytest.mark.skipif(browser.CHROMIUM is None, reason="no chromium; apt-get install chromium")
def test_no_column_of_a_wide_table_is_cut_off(tmp_path: Path) -> None:
    """At a width of 1200 the last column was beyond the page."""
    names = "effect, at, size (95 % interval), probability, not distinguishable from, what it does"
    header = tuple(names.split(", "))
    sizes = "f_c = 0.1234 N m (0.1111 to 0.1357); d = 0.01234 N m s/rad (0.011 to 0.0135)"
    others = "viscous_friction, stribeck_friction, asymmetric_friction, load_friction"
    row = ("coulomb_friction", "shoulder", sizes, "99 %", others, WORDS)
    section = Section(WORDS, tables=[Table(header, [row])], title="What is missing")
    write_document(tmp_path / "page.html", Document("a page", "about", (), [section]))
    with browser.page(tmp_path / "profile") as page:
        page.open((tmp_path / "page.html").as_uri(), width=1200)
        page.wait_for("document.readyState == 'complete'")
        overhang = "(e => e.scrollWidth - e.clientWidth)(document.querySelector('.scroll'))"
        assert page.ask(overhang) <= 0


def test_name_of_a_state_is_no_formula() -> None:
    picture = draw("a label", lambda ax: ax.set(xlabel=r"$\nothing{$ [m]"))
    assert r"$\nothing{$ [m]" in base64.b64decode(picture.source.split(",")[1]).decode()


@pytest.mark.filterwarnings("ignore:.*:RuntimeWarning")
def test_values_beyond_all_scales_are_answered_with_a_sentence() -> None:
    with pytest.raises(InputError, match=r"a line: the values cannot be drawn"):
        draw("a line", lambda ax: ax.plot([0, 1, 2], [-1e308, 0.0, 1e308]))
