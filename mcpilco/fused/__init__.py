"""Particles, fast: `mcpilco.rollout.rollout` with compiled loops and its own backward sweep."""

from mcpilco.fused.engine import rollout, supports

__all__ = ["rollout", "supports"]
