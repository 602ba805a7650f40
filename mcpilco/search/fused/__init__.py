"""The rollout of `mcpilco.search.particles` in compiled loops, with its own backward sweep."""

from mcpilco.search.fused.engine import rollout, unknown

__all__ = ["rollout", "unknown"]
