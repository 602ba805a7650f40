"""What all tests share. The hook on imports must stand before the first import of the package."""

from __future__ import annotations

from collections.abc import Iterator

import jaxtyping
import pytest
import torch

from tests import shapes

shapes.install()

# The workers share the cores: more threads would only wait for one another.
torch.set_num_threads(1)


@pytest.fixture
def unchecked_shapes() -> Iterator[None]:
    """Let wrong shapes through to the code's own checks, as in use."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)
