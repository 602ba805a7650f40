"""Kernels of the difference of two regressors."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.kernels.base import Kernel, Positive, Term, mean_square, typical_size


class RBF(Kernel):
    """k(x, x') = variance * exp(-1/2 sum_d ((x_d - x'_d) / lengthscale_d)^2).

    Args:
        width: D, how many regressors it sees.
        batch: shape of the hyperparameters, `(E,)` for the E outputs of a GP.
        lengthscale: broadcasts to (*batch, D), in the units of the regressors.
        variance: broadcasts to `batch`, in the squared unit of the target.

    Reference: thesis eq. (5.2).
    Differs: the thesis has no 1/2; with it a lengthscale is the standard deviation of the bell.
    """

    lengthscale = Positive()
    variance = Positive()
    log_variance: Tensor

    def __init__(
        self,
        width: int,
        batch: Sequence[int] = (),
        *,
        lengthscale: float | Tensor = 1.0,
        variance: float | Tensor = 1.0,
    ) -> None:
        super().__init__(width, batch)
        self.lengthscale = self.spread(lengthscale, width)
        self.variance = self.spread(variance)

    def forward(
        self, X1: Float[Tensor, "*#b N D"], X2: Float[Tensor, "*#b M D"]
    ) -> Float[Tensor, "*#b N M"]:
        # |a - b|^2 = |a|^2 + |b|^2 - 2 a.b loses digits far from the origin: centre both
        centre = X1.detach().reshape(-1, self.width).mean(0)
        A, B = X1 - centre, X2 - centre
        w = self.lengthscale.pow(-2)
        # the log variance rides on the column: one pass less over the matrix
        column = self.log_variance[..., None, None] - 0.5 * A.square() @ w[..., :, None]
        row = -0.5 * w[..., None, :] @ B.square().mT
        return torch.exp((A * w[..., None, :]) @ B.mT + column + row)

    def diag(self, X: Float[Tensor, "*#b N D"]) -> Float[Tensor, "*#b N"]:
        shape = torch.broadcast_shapes(self.batch, X.shape[:-2])
        return self.variance[..., None].expand(*shape, X.shape[-2])

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Lengthscales of sqrt(D) standard deviations: two samples are then about exp(-1) alike.

        A constant regressor, which no lengthscale can matter to, gets its own size.
        """
        self.lengthscale = typical_size(X) * self.width**0.5
        self.variance = mean_square(Y)

    def terms(self) -> list[Term]:
        w = self.lengthscale.pow(-2)
        return [Term(self.variance, w, w[..., :0], w[..., None, :][..., :0, :])]
