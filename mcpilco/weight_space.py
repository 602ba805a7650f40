"""Gaussian processes of finitely many features, computed with matrices of their number.

Where a kernel is phi^T Lambda phi' of F monomials and there are more samples, all that N samples
say of them is in F + E rows: an orthogonal Q rotates the samples so that

    Q^T [Phi  Y] = [R  Z]   F + E rows;   zeros in all others

The rotated samples have the same likelihood, and the zeros the noise alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log, pi

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.evidence import NegativeLogEvidence, add_to_diagonal, cholesky
from mcpilco.gp import GP
from mcpilco.kernels.monomials import MonomialBasis
from mcpilco.kernels.volterra import VolterraKernel


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

    Args:
        kernel: its monomials must be few enough for matrices of them.
        noise_std: as of `GP`.
        noise_floor: as of `GP`.
        names: as of `GP`.
    """

    kernel: VolterraKernel

    def __init__(self, kernel: VolterraKernel, *arguments, **keywords) -> None:
        super().__init__(kernel, *arguments, **keywords)
        self.basis = MonomialBasis(kernel.width, kernel.degree)
        self._rotated: tuple[Tensor, Tensor, Tensor, Tensor] | None = None

    def nlml(self, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"]) -> Float[Tensor, " E"]:
        R, Z = self._rotate(X, Y)
        variance = self.noise_std.square()
        K = R @ self.kernel.weight_covariance(self.basis) @ R.mT
        rest = 0.5 * (len(X) - len(R)) * (variance.log() + log(2 * pi))
        return NegativeLogEvidence.apply(K, variance, Z, self.names) + rest

    @torch.no_grad()
    def condition(  # type: ignore[override]
        self, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"]
    ) -> WeightPosterior:
        """The posterior given these samples, with the present hyperparameters.

        Raises:
            InputError: the data do not fit the GP, or are not finite.
            NotPositiveDefiniteError: the rotated samples' covariance has no Cholesky factor.
        """
        X, Y = self.check(X, Y)
        R, Z = self._rotate(X, Y)
        Lambda = self.kernel.weight_covariance(self.basis)
        RLambda = R @ Lambda
        noise_std = self.noise_std
        L = cholesky(add_to_diagonal(RLambda @ R.mT, noise_std.square()), self.names)
        # w = Lambda R^T K^-1 z,  Cov = Lambda - Lambda R^T K^-1 R Lambda
        weights = RLambda.mT @ torch.cholesky_solve(Z.mT[..., None], L)
        explained = torch.linalg.solve_triangular(L, RLambda, upper=False)
        values, vectors = torch.linalg.eigh(Lambda - explained.mT @ explained)
        return WeightPosterior(
            basis=self.basis,
            noise_std=noise_std,
            weights=weights.squeeze(-1),
            root=vectors * values.clamp_min(0.0).sqrt()[..., None, :],
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
