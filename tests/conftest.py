"""What all tests share. The hook on imports must stand before the first import of the package."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest
import torch

from tests import shapes

shapes.install()

# The workers share the cores: more threads would only wait for one another.
torch.set_num_threads(1)


@pytest.hookimpl(tryfirst=True)  # before the fixtures of a whole module, which call much
def pytest_runtest_setup() -> None:
    """Each test checks the shapes of what it calls, however often others have called it."""
    shapes.begin_test()


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
