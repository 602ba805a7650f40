"""The rollout of `mcpilco.search.particles` in compiled loops, with its own backward sweep."""

from mcpilco.search.fused.engine import is_on_disk, rollout, skip, unknown

__all__ = ["is_on_disk", "rollout", "skip", "unknown"]
