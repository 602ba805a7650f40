"""Polynomials fitted to a few neighbouring samples, many at a time."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float


def local_fit(
    offsets: Float[np.ndarray, "G K"], values: Float[np.ndarray, "G K"], order: int
) -> tuple[Float[np.ndarray, "G C"], Float[np.ndarray, "G C"], Float[np.ndarray, " G"]]:
    """Least-squares polynomials of G windows with K samples each; NaN samples do not count.

    Args:
        offsets: where the samples are, from where the polynomial is wanted [steps].
        values: of the samples.
        order: of the polynomials; C = order + 1.

    Returns:
        The coefficients (value, slope, ...) at offset 0; their standard deviations for noise of
        standard deviation 1; and the mean square residual per degree of freedom, NaN where there
        is none. All are NaN where fewer than C samples are known.
    """
    known = np.isfinite(values)
    A = offsets[..., None] ** np.arange(order + 1) * known[..., None]
    y = np.where(known, values, 0.0)
    degrees = known.sum(-1) - (order + 1)
    normal = np.einsum("gki,gkj->gij", A, A)
    normal[degrees < 0] = np.eye(order + 1)
    covariance = np.linalg.pinv(normal, hermitian=True)
    coefficients = np.einsum("gij,gkj,gk->gi", covariance, A, y)
    spread = np.sqrt(np.einsum("gii->gi", covariance))
    residual = y - np.einsum("gki,gi->gk", A, coefficients)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_square = np.where(degrees > 0, (residual**2).sum(-1) / degrees, np.nan)
    unknown = degrees < 0
    coefficients[unknown], spread[unknown] = np.nan, np.nan
    return coefficients, spread, mean_square
