"""Pictures without a display, none of which outlives its test."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _closed_figures():
    plt = pytest.importorskip("matplotlib.pyplot")
    plt.switch_backend("Agg")
    yield
    plt.close("all")
