"""The rollout of `mcpilco.search.particles` in compiled loops, with its own backward sweep."""

from mcpilco.search.fused.engine import rollout, unknown
from mcpilco.search.fused.forward import forward

__all__ = ["forward", "rollout", "unknown"]
