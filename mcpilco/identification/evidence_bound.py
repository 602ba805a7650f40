"""The bound on the evidence that `mcpilco.identification.bayesian` raises."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.special import digamma, gammaln

from mcpilco.identification.latent import Latent, Weights
from mcpilco.identification.moments import Moments

_LOG_2PI = float(np.log(2.0 * np.pi))


def bound(
    moments: Moments,
    latent: Latent,
    weights: Weights,
    alpha: Float[np.ndarray, " D"],
    rate: Float[np.ndarray, " D"] | None,
    a0: float | None,
    b0: float,
) -> float:
    """A lower bound on log p(y, X): expected complete log likelihood plus entropies [nats].

    `Differs:` from the print's complete log likelihood, in which p(alpha_m) stands twice; once is
    right.

    Args:
        moments: of the data.
        latent: of the posterior of z and t.
        weights: after the M-step.
        alpha: mean precisions.
        rate: of the posterior Gamma(a0 + 1, rate) of alpha; None without priors.
        a0: shape of the prior; None without priors.
        b0: rate of the prior.
    """
    w, N, D = weights, moments.N, len(weights.w_z)
    xx, yy = np.diag(moments.xx) / N, moments.yy / N
    r_y = yy - 2.0 * latent.yz + latent.total
    r_z = latent.zz - 2.0 * w.w_z * latent.zt + (w.w_z**2 + w.var_z) * latent.tt
    r_x = xx - 2.0 * w.w_x * latent.xt + (w.w_x**2 + w.var_x) * latent.tt
    data = (
        _normal(w.psi_y, r_y)
        + _normal(w.psi_z, r_z).sum()
        + _normal(w.psi_x, r_x).sum()
        + _normal(np.ones(D), latent.tt).sum()
        + 0.5 * (2 * D * (1.0 + _LOG_2PI) + latent.log_det)
    )
    if rate is None or a0 is None:
        return float(N * data)
    a = a0 + 1.0
    log_alpha = digamma(a) - np.log(rate)
    squares = w.w_z**2 + w.var_z + w.w_x**2 + w.var_x
    weights_term = log_alpha - 0.5 * alpha * squares - _LOG_2PI
    weights_entropy = 0.5 * (2.0 * (1.0 + _LOG_2PI) + np.log(w.var_z) + np.log(w.var_x))
    prior = a0 * np.log(b0) - gammaln(a0) + (a0 - 1.0) * log_alpha - b0 * alpha
    entropy = a - np.log(rate) + gammaln(a) + (1.0 - a) * digamma(a)
    return float(N * data + (weights_term + weights_entropy + prior + entropy).sum())


def _normal(variance, square):
    """Expected log density of a normal variable, of its variance and mean squared deviation."""
    return -0.5 * (_LOG_2PI + np.log(variance) + square / variance)
