"""Particles, fast: `mcpilco.rollout.rollout` with compiled loops and its own backward sweep."""

from mcpilco.canonical import supports_physics as supports
from mcpilco.fused.engine import rollout

__all__ = ["rollout", "supports"]
