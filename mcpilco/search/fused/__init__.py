"""Particles, fast: the rollout with compiled loops and its own backward sweep."""

from mcpilco.search.canonical import supports_physics as supports
from mcpilco.search.fused.engine import rollout

__all__ = ["rollout", "supports"]
