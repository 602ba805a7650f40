"""The searches of many seeds at once, step by step together, on one device."""

from mcpilco.agent.lockstep.search import search_together

__all__ = ["search_together"]
