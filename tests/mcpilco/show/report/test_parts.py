from __future__ import annotations

import base64

import pytest

pytest.importorskip("matplotlib")

from mcpilco.show.report.parts import draw
from mcpilco.typing import InputError


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


def test_name_of_a_state_is_no_formula() -> None:
    picture = draw("a label", lambda ax: ax.set(xlabel=r"$\nothing{$ [m]"))
    assert r"$\nothing{$ [m]" in base64.b64decode(picture.source.split(",")[1]).decode()


@pytest.mark.filterwarnings("ignore:.*:RuntimeWarning")
def test_values_beyond_all_scales_are_answered_with_a_sentence() -> None:
    with pytest.raises(InputError, match=r"a line: the values cannot be drawn"):
        draw("a line", lambda ax: ax.plot([0, 1, 2], [-1e308, 0.0, 1e308]))
