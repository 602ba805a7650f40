"""A Gaussian through Gaussian bases: the posterior of GPs, and policies made like one.

    f_e(x) = sum_i beta_ei k_e(x, x_i)
    k_e(x, x') = v_e exp(-1/2 |x - x'|^2_W_e),    W_e = 1 / l_e^2

With K_e^-1 beside beta = K^-1 y this is a GP's posterior: f_e then is uncertain at each x.

All is written with the matrices

    F_k = (s + D_k)^-1,    T_k = (s^-1 + D_k^-1)^-1 = D_k F_k s

of D_k = W_e^-1 for each output, and D_k = (W_a + W_b)^-1 for each pair of outputs: neither needs
the inverse of s, which may be singular or zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor

from baselines.moments.image import Image

_LARGEST = 700.0
"""of an exponent; where one is larger, what it multiplies is below exp(-700)"""


@dataclass(frozen=True)
class Bases:
    """E functions that are sums of Gaussians, certain or not."""

    centres: Float[Tensor, "*b N D"]
    """x_i"""
    lengthscale: Float[Tensor, "*b E D"]
    """l, standard deviation of each bell, in the unit of the inputs"""
    variance: Float[Tensor, "*b E"]
    """v, in the squared unit of each output"""
    weights: Float[Tensor, "*b E N"]
    """beta"""
    inverse: Float[Tensor, "*b E N N"] | None = None
    """K^-1, with the noise in K; None: the functions are known"""

    @property
    def outputs(self) -> int:
        """E."""
        return self.variance.shape[-1]

    @cached_property
    def pairs(self) -> tuple[Int[Tensor, " Q"], Int[Tensor, " Q"]]:
        """All pairs of outputs a <= b."""
        first, second = torch.triu_indices(self.outputs, self.outputs)
        return first, second

    @cached_property
    def widths(self) -> Float[Tensor, "*b K D"]:
        """D_k of each output, and then of each pair."""
        a, b = self.pairs
        w = self.lengthscale.pow(-2)
        return torch.cat([1 / w, 1 / (w[..., a, :] + w[..., b, :])], -2)


def through_bases(bases: Bases, mean: Float[Tensor, "*b D"], cov: Float[Tensor, "*b D D"]) -> Image:
    """The moments of the functions at a Gaussian input; exact, but for rounding.

    The noise of measurements is not added to S. Differentiable in all arguments.

    Raises:
        torch.linalg.LinAlgError: s is no covariance: s + D_k is not positive definite.

    Reference: DFR on exact moment matching, with q, Q and beta as there.
    Differs: S is summed as sum_ij w_ai w_bj (Q_ij / (q_ai q_bj) - 1) with the parenthesis as
        expm1, so that nothing cancels where s is small.
    """
    E, (a, b), D = bases.outputs, bases.pairs, bases.widths
    cov = 0.5 * (cov + cov.mT)  # so that its gradient is symmetric too
    L = torch.linalg.cholesky(cov[..., None, :, :] + torch.diag_embed(D))
    F = torch.cholesky_inverse(L)
    T = D[..., None] * (F @ cov[..., None, :, :])
    # log |I + s D^-1|
    log_det = 2 * L.diagonal(dim1=-2, dim2=-1).log().sum(-1) - D.log().sum(-1)

    # q_ei = E[k_e(x, x_i)] = v_e |I + s W_e|^-1/2 exp(-1/2 nu_i^T F_e nu_i),  nu_i = x_i - m
    nu = (bases.centres - mean[..., None, :])[..., None, :, :]
    r = nu @ F[..., :E, :, :]
    exponent = (r * nu).sum(-1) + log_det[..., :E, None]
    q = bases.variance[..., None] * torch.exp(-0.5 * exponent)
    w = bases.weights * q

    # delta_ij = log(E[k_a(x, x_i) k_b(x, x_j)] / (q_ai q_bj)), with z = W nu:
    #     1/2 z_ai^T (T_ab - T_a) z_ai + 1/2 z_bj^T (T_ab - T_b) z_bj + z_ai^T T_ab z_bj
    #     + 1/2 (log |.|_a + log |.|_b - log |.|_ab)
    z = nu / D[..., :E, None, :]
    own = (z @ T[..., :E, :, :] * z).sum(-1)
    za, zb = z[..., a, :, :], z[..., b, :, :]
    zaT, zbT = za @ T[..., E:, :, :], zb @ T[..., E:, :, :]
    constant = log_det[..., a] + log_det[..., b] - log_det[..., E:]
    column = 0.5 * ((zaT * za).sum(-1) - own[..., a, :] + constant[..., None])
    row = 0.5 * ((zbT * zb).sum(-1) - own[..., b, :])
    delta = zaT @ zb.mT + column[..., :, None] + row[..., None, :]

    # S_ab = cov of the means, and on the diagonal E[v - k^T K^-1 k]
    mass = w[..., a, :, None] * w[..., b, None, :]
    left = torch.zeros_like(log_det[..., E:])
    if bases.inverse is not None:
        (same,) = torch.where(a == b)
        known = bases.inverse * (q[..., :, None] * q[..., None, :])
        mass = mass.index_add(-3, same, known, alpha=-1.0)
        left = left.index_add(-1, same, bases.variance - known.sum((-2, -1)))
    S = (mass * torch.expm1(delta.clamp(max=_LARGEST))).sum((-2, -1)) + left
    where = torch.empty(E, E, dtype=torch.long)
    where[a, b] = where[b, a] = torch.arange(len(a))
    return Image(w.sum(-1), S[..., where], (w[..., None, :] @ r).squeeze(-2).mT)
