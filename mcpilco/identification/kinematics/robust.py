"""Fits that a share of wrong samples does not spoil."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

_FLOOR = 1e-9
"""least residual that the weights of the first fits tell apart, in the unit of the residuals"""
_ABSOLUTE_FITS, _TRIMMED_FITS = 4, 6
_FEWEST = 4
"""samples"""

Fit = Callable[[Float[np.ndarray, "*b N"]], Float[np.ndarray, "*b N"]]
"""from the weights of samples to their residuals, for a batch of problems"""


def trimmed(fit: Fit, seen: Float[np.ndarray, "*b N"], outliers: float) -> Float[np.ndarray, "*b"]:
    """Root mean square of the residuals that are left when the largest are not counted.

    Infinite where there are too few samples to tell.

    Least squares without outliers; otherwise least absolute residuals, then least trimmed squares
    by concentration from there (Rousseeuw & Van Driessen 2006).
    """
    kept = seen.astype(float)
    residuals = fit(kept)
    if outliers > 0:
        for _ in range(_ABSOLUTE_FITS):
            residuals = fit(seen / np.maximum(residuals, _FLOOR))
        for _ in range(_TRIMMED_FITS):
            before, kept = kept, _smallest(residuals, seen, outliers)
            residuals = fit(kept)
            if np.array_equal(kept, before):
                break
    squares = (kept * residuals**2).sum(-1)
    rms = np.sqrt(squares / np.maximum(kept.sum(-1), 1.0))
    return np.where(seen.sum(-1) < _FEWEST, np.inf, rms)


def _smallest(
    residuals: Float[np.ndarray, "*b N"], seen: Float[np.ndarray, "*b N"], outliers: float
) -> Float[np.ndarray, "*b N"]:
    """1 for the smallest residuals, so many as are no outliers."""
    order = np.where(seen > 0, residuals, np.inf).argsort(-1).argsort(-1)
    return (order < np.ceil((1 - outliers) * seen.sum(-1, keepdims=True))).astype(float)
