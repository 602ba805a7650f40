"""What all tests share. The hook on imports must stand before the first import of the package."""

from __future__ import annotations

import gc
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest
import torch

from tests import shapes

shapes.install()
gc.disable()  # until all is imported, which leaves nothing to collect

FIRST = "compiled", "compiled moments", "provenance", "project", "boards"
"""groups of tests: one worker compiles what most need, the next does those that need none of it"""

# The workers share the cores: more threads would only wait for one another.
torch.set_num_threads(1)


@pytest.hookimpl(tryfirst=True)  # before the fixtures of a whole module, which call much
def pytest_runtest_setup() -> None:
    """Each test checks the shapes of what it calls, however often others have called it."""
    shapes.begin_test()


@pytest.hookimpl(tryfirst=True)  # before slow tests are left out and pytest-xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests that share a fixture go to one worker; after `FIRST` those that share most come first.

    Of the cases of a test that is marked `one_in` the others are slow.
    """
    cases: Counter[str] = Counter()
    for item in items:
        if (mark := item.get_closest_marker("one_in")) and not item.get_closest_marker("slow"):
            name = item.nodeid.partition("[")[0]
            if cases[name] % mark.args[0]:
                item.add_marker("slow")
            cases[name] += 1
        if item.get_closest_marker("xdist_group") is None and (shared := _shared_by(item)):
            item.add_marker(pytest.mark.xdist_group(shared))
    sizes = Counter(map(_group_of, items))

    def order(item: pytest.Item) -> tuple[int, int]:
        group = _group_of(item)
        return FIRST.index(group) if group in FIRST else len(FIRST), -sizes[group]

    items.sort(key=order)


def pytest_collection_finish() -> None:
    """The garbage collector needs not look at what was imported again and again."""
    gc.freeze()
    gc.set_threshold(20_000)  # numba and matplotlib make many objects and hardly a circle
    gc.enable()


def _group_of(item: pytest.Item) -> str:
    """The group whose tests one worker does; a test in none is a group of its own."""
    mark = item.get_closest_marker("xdist_group")
    return str(mark.args[0]) if mark else item.nodeid


def _shared_by(item: pytest.Item) -> str:
    """The widest of the fixtures of ours that a test shares with others; "" for none."""
    known = getattr(item, "_fixtureinfo", None)
    last = [all_[-1] for all_ in known.name2fixturedefs.values()] if known else []
    names = {each.scope: each.argname for each in last if each.func.__module__.startswith("tests.")}
    return names.get("session") or ("module" in names and "/".join(item.path.parts[-2:])) or ""


@pytest.fixture
def unchecked_shapes() -> Iterator[None]:
    """Let wrong shapes through to the code's own checks, as in use."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture
def data() -> Path:
    """`../shared/data` beside the checkout, or the folder that MCPILCO_DATA names."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("MCPILCO_DATA", beside))
    if not folder.is_dir():
        pytest.skip("the measured recordings are not here; MCPILCO_DATA names their folder")
    return folder
