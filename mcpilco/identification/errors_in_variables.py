"""Linear regression whose inputs have noise of known size: what least squares shrinks is restored.

With x = t + g, g of covariance Psi, least squares finds (S + Psi)^-1 S b for S the covariance of
t, however many samples there are; (X^T X - N Psi)^-1 X^T y finds b.
"""

from __future__ import annotations

import warnings

import numpy as np
from jaxtyping import Float

from mcpilco.identification.bayesian import UnidentifiedWarning
from mcpilco.identification.moments import Moments
from mcpilco.typing import InputError


def errors_in_variables(
    moments: Moments,
    noise: Float[np.ndarray, " D"] | Float[np.ndarray, "D D"],
    regularisation: float | None = None,
    rank: float = 1e-10,
) -> Float[np.ndarray, " D"]:
    """b of y = t b + noise, for x = t + noise.

    In coordinates in which X^T X is the identity, least squares is X^T y, and each eigenvector of
    N Psi there, with eigenvalue n, has the share r = 1 - n that is not noise. Least squares is to
    be divided by r; it is multiplied by (1 + regularisation) r / (r^2 + regularisation) instead,
    which is 1 where there is no noise, and by 0 where there is nothing else, r <= 0: a direction
    that the noise hides is left out, not blown up.

    Args:
        moments: of the data.
        noise: Psi, the covariance of the noise of an input row, or its diagonal, in the squared
            units of the inputs.
        regularisation: by default D / N, the square of the size of sampling errors in r.
        rank: as for `Moments.least_squares`.

    Raises:
        InputError: noise is no covariance of the inputs.

    Warns:
        UnidentifiedWarning: in some direction the noise is as large as the input.

    Reference: Fuller, Measurement error models, 1987, section 2.2; the regularisation is ours.
    """
    D = len(moments.xy)
    Psi = np.diag(noise) if noise.ndim == 1 else noise
    if Psi.shape != (D, D) or np.linalg.eigvalsh(Psi)[0] < -1e-9 * max(np.trace(Psi), 1e-300):
        raise InputError(
            f"noise must be {D} variances or a covariance of {D} inputs, got shape {noise.shape}; "
            "variances are not negative."
        )
    if regularisation is None:
        regularisation = D / moments.N
    values, vectors, length = moments.directions(rank)
    whiten = vectors / np.sqrt(values) / length[:, None]  # columns of X whiten are orthonormal
    shares, turned = np.linalg.eigh(whiten.T @ (moments.N * Psi) @ whiten)
    r = 1.0 - shares
    hidden = int((r <= np.sqrt(regularisation)).sum())
    if hidden:
        warnings.warn(
            f"{hidden} of {len(r)} directions of the inputs are noise and little else, and are "
            "left out; record longer or faster motions, or give less noise.",
            UnidentifiedWarning,
            stacklevel=2,
        )
    factor = np.where(r > 0.0, (1.0 + regularisation) * r / (r**2 + regularisation), 0.0)
    basis = whiten @ turned
    return basis @ (factor * (basis.T @ moments.xy))
