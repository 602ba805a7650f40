"""What holds of the page of every run."""

from __future__ import annotations

from pathlib import Path

import pytest
from harness import BEGIN, END

RUNS = Path(__file__).parents[2] / "runs"
PAGES = sorted(RUNS.glob("*/README.md"))


def test_every_run_has_a_page():
    folders = {path.name for path in RUNS.iterdir() if (path / "run.py").exists()}
    assert folders <= {page.parent.name for page in PAGES}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.parent.name)
def test_a_command_finds_the_marked_lines_of_its_page(page):
    text = page.read_text(encoding="utf-8")
    assert text.count(BEGIN) == text.count(END) == 1
    assert text.index(BEGIN) < text.index(END)
