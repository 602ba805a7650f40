"""Models of what comes next: Gaussian-process increments, physics as mean, memory, delay."""

__all__: list[str] = []
