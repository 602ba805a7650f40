"""Gaussian processes of many samples through few: a subset of the data, or inducing points.

A subset of the data leaves the other samples out. Inducing points are samples too, but the
posterior of the function at them is that given all: less uncertain, and as cheap to ask.

Reference: E. Snelson, Z. Ghahramani, Sparse Gaussian processes using pseudo-inputs, NeurIPS 2005;
D. R. Burt, C. E. Rasmussen, M. van der Wilk, Convergence of sparse variational inference in
Gaussian processes regression, JMLR 2020 (which samples).
"""

from __future__ import annotations

import copy

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from mcpilco.gp.evidence import add_to_diagonal, cholesky
from mcpilco.gp.gp import GP, Posterior


def evenly_spaced(samples: int, most: int) -> Int[np.ndarray, " kept"]:
    """Indices of at most so many of the samples, the first and the last among them."""
    return np.linspace(0, samples - 1, min(samples, most)).round().astype(int)


@torch.no_grad()
def subset_of_data(
    gp: GP, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"], threshold: float = 0.5
) -> Int[Tensor, " kept"]:
    """Indices of the samples worth keeping, in time order.

    A sample stays if, given those kept before it, the latent function there is still uncertain: its
    posterior standard deviation exceeds `threshold` noise standard deviations for any output. The
    first sample always stays. It takes O(N M^2) for M kept of N.

    The GP is fitted already. The authors use a threshold of 0.5 [-]; 0 keeps everything. A Gaussian
    posterior's variance does not depend on the targets.

    Returns:
        Ascending row numbers, to index X and Y with.
    """
    X, _ = gp.check(X, Y)
    known = _Known(gp, X)
    for i in range(len(X)):
        if not known.rows or known.doubt[i] > threshold**2:
            known.add(i)
    return torch.tensor(known.rows)


@torch.no_grad()
def inducing_points(
    gp: GP, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"], most: int, threshold: float = 0.1
) -> Int[Tensor, " kept"]:
    """Indices of the samples that tell most of the function at all others.

    One after the other, that of the largest posterior variance beside the noise's, in any output,
    given those before it: until there are `most`, or the standard deviation is nowhere above
    `threshold` noise standard deviations. One there is always. It takes O(N M^2) for M of N.

    Returns:
        Ascending row numbers, to index X and Y with.
    """
    X, _ = gp.check(X, Y)
    known = _Known(gp, X)
    while not known.rows or (len(known.rows) < most and known.doubt.max() > threshold**2):
        known.add(int(known.doubt.argmax()))
    return torch.tensor(sorted(known.rows))


class _Known:
    """The latent function's variance at all samples, given some of them.

    The Cholesky factor of the known samples grows by one column with each, and with it the variance
    of all the others falls.
    """

    def __init__(self, gp: GP, X: Float[Tensor, "N D"]) -> None:
        self._gp, self._X = gp, X
        self._noise = gp.noise_std.square()
        self._variance = gp.kernel.diag(X).clone()  # E N
        self._columns = X.new_zeros(gp.outputs, 0, len(X))  # rows of L^T, L L^T = K + s^2 I
        self.rows: list[int] = []
        """which are known, in the order in which they became so"""

    @property
    def doubt(self) -> Float[Tensor, " N"]:
        """The largest variance of an output beside that of its noise [-]."""
        return (self._variance / self._noise[:, None]).amax(0)

    def add(self, i: int) -> None:
        """Sample i becomes known."""
        self.rows.append(i)
        # L_ji = (k_ij - sum_m L_im L_jm) / L_ii,  L_ii^2 = variance_i + s^2
        pivot = (self._variance[:, i] + self._noise).sqrt()
        explained = self._columns[:, None, :, i] @ self._columns
        column = (self._gp.kernel(self._X[i : i + 1], self._X) - explained) / pivot[:, None, None]
        self._columns = torch.cat([self._columns, column], 1)
        self._variance -= column.squeeze(1).square()


@torch.no_grad()
def condition_through(
    gp: GP, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"], inducing: Int[Tensor, " M"]
) -> Posterior:
    """The posterior given all N samples, that of the function at M of them in the middle.

    With Z the M samples, k their covariances with a query, and B = K_ZZ + K_ZX Lambda^-1 K_XZ,

        mean = k^T B^-1 K_ZX Lambda^-1 y,    variance = k** - k^T (K_ZZ^-1 - B^-1) k

    so that an exact posterior's form serves, of M samples: L^-1 is a lower triangular root of
    K_ZZ^-1 - B^-1. Lambda is the noise's variance and what the function at Z leaves open of that at
    each sample. Where the M are all samples it is exact.

    Raises:
        InputError: the data do not fit the GP, or are not finite.
        NotPositiveDefiniteError: the samples' covariances have no Cholesky factor.

    Reference: Snelson & Ghahramani 2005, eqs. (6) to (8) (FITC).
    """
    X, Y = gp.check(X, Y)
    Z, names = X[inducing], gp.names
    identity = torch.eye(len(Z), dtype=Z.dtype).expand(gp.outputs, -1, -1)
    L = cholesky(gp.kernel(Z, Z), names)
    # the function at Z is L v: C is the root of v's precision, W / std what the samples say of it
    W = torch.linalg.solve_triangular(L, gp.kernel(Z, X), upper=False)
    left = (gp.kernel.diag(X) - W.square().sum(-2)).clamp_min(0.0)
    std = (gp.noise_std.square()[:, None] + left).sqrt()[:, None]
    W = W / std
    C = cholesky(add_to_diagonal(W @ W.mT, torch.ones(gp.outputs, dtype=Z.dtype)), names)
    v = torch.cholesky_solve(W @ (Y.mT[:, None] / std).mT, C)
    # K_ZZ^-1 - B^-1 = L^-T (I - C^-1) L^-1, and I - C^-1 = G^T G
    learned = (identity - torch.cholesky_inverse(C)).flip(-1, -2)
    G = cholesky(learned, names).mT.flip(-1, -2)
    L_inv = torch.linalg.solve_triangular(L, G, upper=False, left=False)
    return Posterior(
        kernel=copy.deepcopy(gp.kernel).requires_grad_(False),
        noise_std=gp.noise_std,
        X=Z,
        L=torch.linalg.solve_triangular(L_inv, identity, upper=False),
        L_inv=L_inv,
        alpha=torch.linalg.solve_triangular(L.mT, v, upper=True).squeeze(-1),
    )
