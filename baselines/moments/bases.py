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
from torch.autograd.function import once_differentiable

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

    @property
    def constant(self) -> bool:
        """Whether no gradient flows to the functions themselves."""
        parts = (self.centres, self.lengthscale, self.variance, self.weights, self.inverse)
        return not any(part is not None and part.requires_grad for part in parts)


def through_bases(bases: Bases, mean: Float[Tensor, "*b D"], cov: Float[Tensor, "*b D D"]) -> Image:
    """The moments of the functions at a Gaussian input; exact, but for rounding.

    The noise of measurements is not added to S. Differentiable; where the functions are constants,
    by a closed gradient.

    Args:
        bases: the functions.
        mean: m, in the units of the inputs.
        cov: s; may be singular or zero.

    Raises:
        torch.linalg.LinAlgError: s is no covariance: s + D_k is not positive definite.

    Reference: DFR on exact moment matching, with q, Q and beta as there.
    Differs: S is summed as sum_ij w_ai w_bj (Q_ij / (q_ai q_bj) - 1) with the parenthesis as
        expm1, so that nothing cancels where s is small.
    """
    if bases.constant:
        return Image(*_ThroughConstant.apply(bases, mean, cov))
    found = _Expectations(bases, mean, cov)
    return Image(found.mean(), found.cov(), found.slope())


class _Expectations:
    """The terms of the moments; the letters are those of the module's head."""

    def __init__(self, bases: Bases, mean: Tensor, cov: Tensor) -> None:
        self.bases = bases
        E, (a, b) = bases.outputs, bases.pairs
        D = bases.widths
        L = torch.linalg.cholesky(cov[..., None, :, :] + torch.diag_embed(D))
        self.F = torch.cholesky_inverse(L)
        self.T = D[..., None] * (self.F @ cov[..., None, :, :])
        # log |I + s D^-1|
        log_det = 2 * L.diagonal(dim1=-2, dim2=-1).log().sum(-1) - D.log().sum(-1)

        # q_ei = E[k_e(x, x_i)] = v_e |I + s W_e|^-1/2 exp(-1/2 nu_i^T F_e nu_i),  nu_i = x_i - m
        self.nu = bases.centres - mean[..., None, :]
        self.r = self.nu[..., None, :, :] @ self.F[..., :E, :, :]
        exponent = (self.r * self.nu[..., None, :, :]).sum(-1) + log_det[..., :E, None]
        self.q = bases.variance[..., None] * torch.exp(-0.5 * exponent)
        self.w = bases.weights * self.q

        # delta_ij = log(E[k_a(x, x_i) k_b(x, x_j)] / (q_ai q_bj)), with z = W nu:
        #     1/2 z_ai^T (T_ab - T_a) z_ai + 1/2 z_bj^T (T_ab - T_b) z_bj + z_ai^T T_ab z_bj
        #     + 1/2 (log |.|_a + log |.|_b - log |.|_ab)
        z = self.nu[..., None, :, :] / D[..., :E, None, :]
        own = z @ self.T[..., :E, :, :]
        self.za, self.zb = z[..., a, :, :], z[..., b, :, :]
        zaT = self.za @ self.T[..., E:, :, :]
        self.ha = zaT - own[..., a, :, :]
        self.hb = self.zb @ self.T[..., E:, :, :] - own[..., b, :, :]
        constant = log_det[..., a] + log_det[..., b] - log_det[..., E:]
        column = 0.5 * ((self.ha * self.za).sum(-1) + constant[..., None])
        row = 0.5 * (self.hb * self.zb).sum(-1)
        delta = zaT @ self.zb.mT + column[..., :, None] + row[..., None, :]
        self.growth = torch.expm1(delta.clamp(max=_LARGEST))

    @property
    def diagonal(self) -> Int[Tensor, " E"]:
        """Which pairs are of one output with itself."""
        a, b = self.bases.pairs
        return (a == b).nonzero()[:, 0]

    def mean(self) -> Tensor:
        """M_e = sum_i beta_ei q_ei."""
        return self.w.sum(-1)

    def slope(self) -> Tensor:
        """V_e = F_e sum_i beta_ei q_ei nu_i."""
        return (self.w[..., None, :] @ self.r).squeeze(-2).mT

    def mass(self) -> Tensor:
        """The weight of each entry of `growth`: w_ai w_bj, less K^-1 q q on the diagonal."""
        a, b = self.bases.pairs
        weights = self.w[..., a, :, None] * self.w[..., b, None, :]
        if self.bases.inverse is None:
            return weights
        known = self.bases.inverse * (self.q[..., :, None] * self.q[..., None, :])
        return weights.index_add(-3, self.diagonal, known, alpha=-1.0)

    def cov(self) -> Tensor:
        """S_ab = cov of the means, and on the diagonal E[variance]."""
        return self.square((self.mass() * self.growth).sum((-2, -1)))

    def square(self, upper: Tensor) -> Tensor:
        """The matrix of these values of the pairs, with E[v - q^T K^-1 q] on its diagonal."""
        E, (a, b) = self.bases.outputs, self.bases.pairs
        if self.bases.inverse is not None:
            Kq = (self.bases.inverse @ self.q[..., None]).squeeze(-1)
            left = self.bases.variance - (self.q * Kq).sum(-1)
            upper = upper.index_add(-1, self.diagonal, left)
        where = torch.empty(E, E, dtype=torch.long)
        where[a, b] = where[b, a] = torch.arange(len(a))
        return upper[..., where]


class _ThroughConstant(torch.autograd.Function):
    """The same with a closed gradient, of which the N x N part is one product for each pair."""

    @staticmethod
    def forward(ctx, bases, mean, cov):
        ctx.found = found = _Expectations(bases, mean, cov)
        ctx.shapes = mean.shape, cov.shape
        ctx.mass = found.mass()
        return found.mean(), found.square((ctx.mass * found.growth).sum((-2, -1))), found.slope()

    @staticmethod
    @once_differentiable
    def backward(ctx, to_mean, to_cov, to_slope):
        f, bases = ctx.found, ctx.found.bases
        E, (a, b), D = bases.outputs, bases.pairs, bases.widths
        F, T = f.F, f.T[..., E:, :, :]

        # S, by way of delta: G is the gradient to delta
        up = (to_cov + to_cov.mT)[..., a, b]
        up = torch.where(a == b, 0.5 * up, up)
        G = (up[..., None, None] * ctx.mass).mul_(f.growth + 1.0)
        rows, columns = G.sum(-1, keepdim=True), G.sum(-2)[..., None]
        Gzb, Gza = G @ f.zb, G.mT @ f.za
        za_rows, zb_columns = 0.5 * f.za.mT @ (rows * f.za), 0.5 * f.zb.mT @ (columns * f.zb)
        to_T = f.T.new_zeros(f.T.shape)
        to_T[..., E:, :, :] = f.za.mT @ Gzb + za_rows + zb_columns
        to_T.index_add_(-3, a, za_rows, alpha=-1.0).index_add_(-3, b, zb_columns, alpha=-1.0)
        total = 0.5 * rows.sum((-2, -1))
        to_log_det = f.T.new_zeros(f.T.shape[:-2])
        to_log_det[..., E:] = -total
        to_log_det.index_add_(-1, a, total).index_add_(-1, b, total)
        to_z = torch.zeros_like(f.r)
        to_z.index_add_(-3, a, rows * f.ha + Gzb @ T).index_add_(-3, b, columns * f.hb + Gza @ T)

        # w and q: by way of M, V and the weights of delta
        to_w = to_mean[..., None] + (f.r @ to_slope.mT[..., None]).squeeze(-1)
        of_b = up[..., None] * (f.growth @ f.w[..., b, :, None]).squeeze(-1)
        of_a = up[..., None] * (f.growth.mT @ f.w[..., a, :, None]).squeeze(-1)
        to_w = to_w.index_add(-2, a, of_b).index_add(-2, b, of_a)
        to_q = bases.weights * to_w
        if bases.inverse is not None:
            own = f.diagonal
            grown = bases.inverse * (f.growth[..., own, :, :] + 1.0)
            to_q = to_q - 2 * up[..., own, None] * (grown @ f.q[..., None]).squeeze(-1)
        to_log_q = (to_q * f.q)[..., None]
        to_log_det[..., :E] -= 0.5 * to_log_q.sum((-2, -1))

        # nu, and with it m
        nu, slopes = f.nu[..., None, :, :], to_slope.mT[..., None, :]
        to_nu = to_z / D[..., :E, None, :] - to_log_q * f.r
        to_nu = to_nu + f.w[..., None] * (slopes @ F[..., :E, :, :])
        # F and T, and with them s: dF = -F ds F, dT = D F ds F D
        inner = D[..., :, None] * to_T * D[..., None, :]
        inner[..., :E, :, :] -= (f.w[..., None, :] @ nu).mT @ slopes
        inner[..., :E, :, :] += 0.5 * nu.mT @ (to_log_q * nu)
        to_s = (F @ inner @ F + to_log_det[..., None, None] * F).sum(-3)
        to_s = 0.5 * (to_s + to_s.mT)
        shape_of_mean, shape_of_cov = ctx.shapes
        return None, -to_nu.sum((-3, -2)).sum_to_size(shape_of_mean), to_s.sum_to_size(shape_of_cov)
