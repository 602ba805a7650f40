"""What the tests of several runs need."""

from __future__ import annotations

import dataclasses

import pytest

from mcpilco.config import PRESETS, PolicyConfig, SearchConfig


@pytest.fixture
def hasty(monkeypatch):
    """A preset that learns nothing in no time."""
    search = SearchConfig(particles=8, steps=(2,), restarts=(0,), evaluation_particles=8)
    config = dataclasses.replace(
        PRESETS["default"].config, policy=PolicyConfig(bases=10), search=search
    )
    preset = dataclasses.replace(PRESETS["default"], config=config)
    monkeypatch.setitem(PRESETS, "default", preset)
