"""When compiled code is compiled anew."""

from __future__ import annotations

import pytest

from mcpilco import compiling


@pytest.fixture
def package(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling, "__file__", str(tmp_path / "compiling.py"))
    folder = tmp_path / "loops"
    folder.mkdir()
    (folder / "a.py").write_text("a = 1")
    (folder / "b.py").write_text("b = 1")
    return folder


def test_equal_sources_have_equal_digests(package):
    before = compiling.digest("loops")
    (package / "a.py").write_text("a = 1")
    (package / "notes.txt").write_text("not compiled")
    assert compiling.digest("loops") == before


@pytest.mark.parametrize("name", ["a.py", "b.py", "c.py"])
def test_a_change_of_any_file_changes_the_digest(package, name):
    before = compiling.digest("loops")
    (package / name).write_text("x = 2")
    assert compiling.digest("loops") != before


def test_a_digest_covers_each_package_that_is_named(package):
    more = package.parent / "more"
    more.mkdir()
    (more / "b.py").write_text("b = 1")
    before = compiling.digest("loops", "more")
    (more / "c.py").write_text("c = 1")
    assert compiling.digest("loops", "more") != before


def test_a_digest_of_nothing_is_refused(package):
    with pytest.raises(FileNotFoundError, match="gone has none"):
        compiling.digest("loops", "gone")
