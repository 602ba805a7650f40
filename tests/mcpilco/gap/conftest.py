"""Fixtures that several tests of the room share."""

from tests.mcpilco.gap.lagging import lagging  # noqa: F401  a fixture
