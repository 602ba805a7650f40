"""Policies, the costs that judge them, and costs that are learned from rewards."""

__all__: list[str] = []
