"""The report on a fit, the same for every method of identification."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from mcpilco.gp import GP, JITTERS, Posterior


@dataclass(frozen=True)
class Report:
    """How a fit went, and what the data did not determine."""

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

    @classmethod
    def of_gps(cls, gps: Iterable[GP], **more: tuple) -> Report:
        """Of Gaussian processes that were fitted, all outputs together; `more` are other fields."""
        fits = [gp.report for gp in gps if gp.report is not None]
        return cls(
            converged=all(fit.converged for fit in fits),
            iterations=sum(fit.iterations for fit in fits),
            evidence=tuple(-nlml for fit in fits for nlml in fit.nlml),
            **more,
        )


def jitter_of(posterior: Posterior) -> tuple[float, ...]:
    """The one of `JITTERS` on each output's covariance, in parts of its mean [-]."""
    diagonal = posterior.kernel.diag(posterior.X) + posterior.noise_std.square()[:, None]
    added = (posterior.L.square().sum(-1) - diagonal).mean(-1) / diagonal.mean(-1)
    return tuple(min(JITTERS, key=lambda jitter: abs(jitter - share)) for share in added.tolist())
