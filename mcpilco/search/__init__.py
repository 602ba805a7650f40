"""The policy search: particle rollouts, plain and compiled, and descent along their gradient."""

__all__: list[str] = []
