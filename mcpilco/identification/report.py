"""What a fit says of itself, the same for every method of identification."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Report:
    """How a fit went, and what the data could not tell it."""

    converged: bool
    """the optimiser stopped by its own tolerance, for every output"""
    iterations: int
    """optimiser steps, all outputs and starts together"""
    evidence: tuple[float, ...] = ()
    """log marginal likelihood of each output [-]; empty for methods without one"""
    jitter: tuple[float, ...] = ()
    """what was added to the diagonal of each output's covariance, in parts of its mean [-]"""
    unidentified: tuple[str, ...] = ()
    """names of the parameters that the data do not determine"""
    warnings: tuple[str, ...] = ()
    """sentences for a person: what looks wrong, and what to record instead"""
