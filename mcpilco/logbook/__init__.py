"""What a run writes down: its folder, its metrics, its callbacks."""

__all__: list[str] = []
