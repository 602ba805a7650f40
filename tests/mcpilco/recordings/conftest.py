"""Where the measured recordings are that the project does not carry."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]


@pytest.fixture
def data() -> Path:
    """`../shared/data` beside the checkout, or the folder that MCPILCO_DATA names."""
    folder = Path(os.environ.get("MCPILCO_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("the measured recordings are not here; MCPILCO_DATA names their folder")
    return folder
