"""Where simulation and recordings disagree, what is missing, and what adding it is worth."""

from mcpilco.gap.investigate import Gap, investigate

__all__ = ["Gap", "investigate"]
