"""When compiled code is compiled anew."""

from __future__ import annotations

import pytest

from mcpilco import compiling as sources


@pytest.fixture
def package(tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "__file__", str(tmp_path / "sources.py"))
    folder = tmp_path / "loops"
    folder.mkdir()
    (folder / "a.py").write_text("a = 1")
    (folder / "b.py").write_text("b = 1")
    return folder


def test_equal_sources_have_equal_digests(package):
    before = sources.digest("loops")
    (package / "a.py").write_text("a = 1")
    (package / "notes.txt").write_text("not compiled")
    assert sources.digest("loops") == before


@pytest.mark.parametrize("name", ["a.py", "b.py", "c.py"])
def test_a_change_of_any_file_changes_the_digest(package, name):
    before = sources.digest("loops")
    (package / name).write_text("x = 2")
    assert sources.digest("loops") != before


def test_a_digest_covers_each_package_that_is_named(package):
    more = package.parent / "more"
    more.mkdir()
    before = sources.digest("loops", "more")
    (more / "c.py").write_text("c = 1")
    assert sources.digest("loops", "more") != before
