"""Products of linear kernels: priors over polynomials."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.kernels.base import Kernel, Positive, Term, mean_square
from mcpilco.typing import InputError


class Linear(Kernel):
    """k(x, x') = bias + sum_d weights_d x_d x'_d, the factor that polynomial kernels are made of.

    Args:
        width: D, how many regressors it sees.
        batch: shape of the hyperparameters, `(E,)` for the E outputs of a GP.
        bias: False leaves the bias out, and every function is zero at the origin.
    """

    weights = Positive()
    bias = Positive()

    def __init__(self, width: int, batch: Sequence[int] = (), bias: bool = True) -> None:
        super().__init__(width, batch)
        self.has_bias = bias
        self.weights = self.spread(1.0, width)
        if bias:
            self.bias = self.spread(1.0)

    def forward(
        self, X1: Float[Tensor, "*#b N D"], X2: Float[Tensor, "*#b M D"]
    ) -> Float[Tensor, "*#b N M"]:
        linear = (X1 * self.weights[..., None, :]) @ X2.mT
        return linear + self.bias[..., None, None] if self.has_bias else linear

    def diag(self, X: Float[Tensor, "*#b N D"]) -> Float[Tensor, "*#b N"]:
        linear = (X.square() * self.weights[..., None, :]).sum(-1)
        return linear + self.bias[..., None] if self.has_bias else linear

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Every regressor, and the bias, explains an equal share."""
        self.weights = self.spread(1.0 / mean_square(X), self.width)
        if self.has_bias:
            self.bias = self.spread(1.0)
        share = mean_square(Y) / self.diag(X).mean(-1)
        self.weights = self.weights * share[..., None]
        if self.has_bias:
            self.bias = self.bias * share

    def terms(self) -> list[Term]:
        v = torch.ones_like(self.weights[..., 0])
        c = self.bias if self.has_bias else torch.zeros_like(v)
        w = torch.zeros_like(self.weights)
        return [Term(v, w, c[..., None], self.weights[..., None, :])]


class MPK(Kernel):
    """k(x, x') = prod_{p=1..degree} (offsets_p + sum_d weights_pd x_d x'_d).

    The factors are ordered, so that no permutation of them is another optimum: offsets and weights
    are sums sigma_p = a_p + a_{p+1} + ... + a_degree of positive steps a, `offset_steps` and
    `weight_steps`. Small a_pd for all p > q keep the degree of the d-th regressor at q or below.

    Args:
        width: D, how many regressors it sees.
        degree: how many factors, and so the degree of the polynomials.
        batch: shape of the hyperparameters, `(E,)` for the E outputs of a GP.

    Reference: thesis eqs. (5.10), (6.24) and (6.28).
    Differs: the offsets have the hierarchy too.
    """

    weight_steps = Positive()
    offset_steps = Positive()
    _later: Tensor

    def __init__(self, width: int, degree: int, batch: Sequence[int] = ()) -> None:
        super().__init__(width, batch)
        if degree < 1:
            raise InputError(f"MPK needs a degree of at least 1, got {degree}.")
        self.degree = degree
        self.register_buffer("_later", torch.ones(degree, degree).double().triu(), persistent=False)
        self.weight_steps = self.spread(1.0, degree, width)
        self.offset_steps = self.spread(1.0, degree)

    @property
    def weights(self) -> Float[Tensor, "*b degree D"]:
        """sigma_p, from the largest to the smallest."""
        return self._later @ self.weight_steps

    @property
    def offsets(self) -> Float[Tensor, "*b degree"]:
        """sigma0_p, from the largest to the smallest."""
        return self.offset_steps @ self._later.mT

    def forward(
        self, X1: Float[Tensor, "*#b N D"], X2: Float[Tensor, "*#b M D"]
    ) -> Float[Tensor, "*#b N M"]:
        offsets, weights = self.offsets.unbind(-1), self.weights.unbind(-2)
        factors = (
            c[..., None, None] + (X1 * s[..., None, :]) @ X2.mT
            for c, s in zip(offsets, weights, strict=True)
        )
        return reduce(torch.mul, factors)

    def diag(self, X: Float[Tensor, "*#b N D"]) -> Float[Tensor, "*#b N"]:
        return (self.offsets[..., None, :] + X.square() @ self.weights.mT).prod(-1)

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Every regressor, and the offset, explains an equal share of each factor."""
        self.weight_steps = self.spread(1.0 / mean_square(X), self.degree, self.width)
        self.offset_steps = self.spread(1.0, self.degree)
        share = (mean_square(Y) / self.diag(X).mean(-1)).pow(1 / self.degree)
        self.weight_steps = self.weight_steps * share[..., None, None]
        self.offset_steps = self.offset_steps * share[..., None]

    def terms(self) -> list[Term]:
        v = torch.ones_like(self.offsets[..., 0])
        w = torch.zeros_like(self.weights[..., 0, :])
        return [Term(v, w, self.offsets, self.weights)]
