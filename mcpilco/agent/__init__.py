"""Agents that learn by trials: MC-PILCO, its model, its episodes, its files."""

__all__: list[str] = []
