"""Gaussian processes with fewer numbers than samples: of few features.

Where a kernel is phi^T Lambda phi' of F monomials and there are more samples, all that N samples
say of them is in F + E rows: an orthogonal Q rotates the samples so that

    Q^T [Phi  Y] = [R  Z]   F + E rows;   zeros in all others

The rotated samples have the same likelihood, and the zeros the noise alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log, pi
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from mcpilco.gp.gp import GP
from mcpilco.kernels import MonomialBasis, VolterraKernel

if TYPE_CHECKING:
    from mcpilco.gp.gp import GP


@dataclass(frozen=True, eq=False)
class WeightPosterior:
    """E polynomials, conditioned on samples: a Gaussian over their F coefficients."""

    basis: MonomialBasis
    """phi"""
    noise_std: Float[Tensor, " E"]
    """noise standard deviation, in the unit of each output"""
    weights: Float[Tensor, "E F"]
    """the coefficients' means"""
    root: Float[Tensor, "E F F"]
    """the coefficients' covariance is root root^T"""

    def mean_and_variance(
        self, Xq: Float[Tensor, "*b M D"]
    ) -> tuple[Float[Tensor, "*b M E"], Float[Tensor, "*b M E"]]:
        """Mean and variance of the polynomials, without the noise, at the queries."""
        phi = self.basis(Xq)
        variance = (phi[..., None, :, :] @ self.root).square().sum(-1)
        return phi @ self.weights.mT, variance.mT


class WeightSpaceGP(GP):
    """A GP that computes in the space of its kernel's monomials: equal to `GP`, but for rounding.

    Worth it where there are fewer monomials than samples.

    The monomials of its kernel must be few enough for matrices of them; other arguments are those
    of `GP`.
    """

    kernel: VolterraKernel

    def __init__(self, kernel: VolterraKernel, *arguments, **keywords) -> None:
        super().__init__(kernel, *arguments, **keywords)
        self.basis = MonomialBasis(kernel.width, kernel.degree)
        self._rotated: tuple[Tensor, Tensor, Tensor, Tensor] | None = None

    def nlml(self, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"]) -> Float[Tensor, " E"]:
        R, Z = self._rotate(X, Y)
        Lambda = self.kernel.weight_covariance(self.basis)
        return _NegativeLogEvidence.apply(Lambda, self.noise_std.square(), R, Z, len(X))

    @torch.no_grad()
    def condition(  # type: ignore[override]
        self, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"]
    ) -> WeightPosterior:
        """The posterior given these samples, with the present hyperparameters.

        Raises:
            InputError: the data do not fit the GP, or are not finite.
        """
        X, Y = self.check(X, Y)
        R, Z = self._rotate(X, Y)
        noise_std = self.noise_std
        A = _root(self.kernel.weight_covariance(self.basis))
        Q, U = _factorise(R, A, noise_std.square())
        # the coefficients are A v,  v ~ N(0, I) beforehand:  v | z ~ N(U^-1 Q^T z, s^2 (U^T U)^-1)
        v = torch.linalg.solve_triangular(U, Q.mT @ Z.mT[..., None], upper=True)
        identity = torch.eye(U.shape[-1], dtype=U.dtype)
        U_inv = torch.linalg.solve_triangular(U, identity, upper=True)
        return WeightPosterior(
            basis=self.basis,
            noise_std=noise_std,
            weights=(A @ v).squeeze(-1),
            root=noise_std[:, None, None] * A @ U_inv,
        )

    def _rotate(self, X: Tensor, Y: Tensor) -> tuple[Tensor, Tensor]:
        """R and Z, found once for the same data."""
        if self._rotated is None or self._rotated[0] is not X or self._rotated[1] is not Y:
            both = torch.cat([self.basis(X), Y], 1)
            if len(both) > both.shape[1]:
                both = torch.linalg.qr(both, mode="r").R
            R, Z = both.split([both.shape[1] - self.outputs, self.outputs], 1)
            self._rotated = X, Y, R, Z
        return self._rotated[2], self._rotated[3]


class _NegativeLogEvidence(torch.autograd.Function):
    """-log N(y; 0, Phi Lambda Phi^T + s^2 I) from the rotated samples; no jitter is ever needed."""

    @staticmethod
    def forward(ctx, Lambda, noise_variance, R, Z, samples):
        Q, U = _factorise(R, _root(Lambda), noise_variance)
        # K = R Lambda R^T + s^2 I:  K^-1 = (I - Q Q^T) / s^2,  |K| = |U|^2 s^(2 (N - F))
        z = Z.mT[..., None]
        alpha = (z - Q @ (Q.mT @ z)) / noise_variance[:, None, None]
        ctx.save_for_backward(R, Q, alpha, noise_variance)
        ctx.samples = samples
        log_det = 2.0 * U.diagonal(dim1=-2, dim2=-1).abs().log().sum(-1)
        log_det = log_det + (samples - U.shape[-1]) * noise_variance.log()
        return 0.5 * ((z * alpha).sum((-2, -1)) + log_det + samples * log(2 * pi))

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):
        # d nlml / dK = 1/2 (K^-1 - alpha alpha^T); the samples that are not there add N - len(R)
        # times 1 / s^2 to the trace of K^-1
        R, Q, alpha, noise_variance = ctx.saved_tensors
        RQ, Ra = R.mT @ Q, R.mT @ alpha
        for_lambda = (R.mT @ R - RQ @ RQ.mT) / noise_variance[:, None, None] - Ra @ Ra.mT
        trace = (ctx.samples - Q.square().sum((-2, -1))) / noise_variance
        for_noise = trace - alpha.square().sum((-2, -1))
        half = 0.5 * gradient
        return half[:, None, None] * for_lambda, half * for_noise, None, None, None


def _factorise(
    R: Float[Tensor, "M F"], A: Float[Tensor, "E F F"], noise_variance: Float[Tensor, " E"]
) -> tuple[Float[Tensor, "E M F"], Float[Tensor, "E F F"]]:
    """Q and U of R A = Q U, with U^T U = A^T R^T R A + s^2 I."""
    identity = torch.eye(A.shape[-1], dtype=A.dtype)
    noise = noise_variance.sqrt()[:, None, None] * identity
    stacked, U = torch.linalg.qr(torch.cat([R @ A, noise], -2))
    return stacked[..., : len(R), :], U


def _root(Lambda: Float[Tensor, "E F F"]) -> Float[Tensor, "E F F"]:
    """A with A A^T = Lambda, which may be singular."""
    L, info = torch.linalg.cholesky_ex(Lambda)
    if not info.any():
        return L
    values, vectors = torch.linalg.eigh(Lambda)
    return vectors * values.clamp_min(0.0).sqrt()[..., None, :]
