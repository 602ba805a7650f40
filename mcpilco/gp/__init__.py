"""Gaussian-process regression: exact posteriors, evidence, sparse subsets, weight space."""

__all__: list[str] = []
