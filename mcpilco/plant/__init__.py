"""Plants: what a machine is made of, the effects that may act on it, and its simulation."""

__all__: list[str] = []
