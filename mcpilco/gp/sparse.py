"""Fewer samples for the same posterior."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from jaxtyping import Float, Int
from torch import Tensor

if TYPE_CHECKING:
    from mcpilco.gp.gp import GP


@torch.no_grad()
def subset_of_data(
    gp: GP, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"], threshold: float = 0.5
) -> Int[Tensor, " kept"]:
    """Indices of the samples worth keeping, in time order.

    A sample stays if, given those kept before it, the latent function there is still uncertain: its
    posterior standard deviation exceeds `threshold` noise standard deviations for any output. The
    first sample always stays.

    The Cholesky factor of the kept samples grows by one column with each, and with it the variance
    of all the others falls: O(N M^2) for M kept of N.

    The GP is fitted already. The authors use a threshold of 0.5 [-]; 0 keeps everything. A Gaussian
    posterior's variance does not depend on the targets.

    Returns:
        Ascending row numbers, to index X and Y with.
    """
    X, _ = gp.check(X, Y)
    noise_variance = gp.noise_std.square()
    variance = gp.kernel.diag(X).clone()  # latent variance of each sample given those kept, (E, N)
    columns = X.new_zeros(gp.outputs, 0, len(X))  # rows of L^T for the kept ones, L L^T = K + s^2 I
    kept: list[int] = []
    for i in range(len(X)):
        worth = (variance[:, i] > threshold**2 * noise_variance).any()
        if kept and not worth:
            continue
        kept.append(i)
        # L_ji = (k_ij - sum_m L_im L_jm) / L_ii,  L_ii^2 = variance_i + s^2
        pivot = (variance[:, i] + noise_variance).sqrt()
        explained = columns[:, None, :, i] @ columns
        column = (gp.kernel(X[i : i + 1], X) - explained) / pivot[:, None, None]
        columns = torch.cat([columns, column], 1)
        variance -= column.squeeze(1).square()
    return torch.tensor(kept)
