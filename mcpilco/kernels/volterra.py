"""Priors over Volterra series: polynomials of lagged inputs, a covariance for each of their maps.

    y_k = h_0 + sum_{i=1..r} sum_{t_1..t_i} h_i(t_1, ..., t_i) x_t1 ... x_ti,    x_t = u_{k-t}

Reference: thesis chapter 6.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import reduce
from itertools import permutations
from operator import mul
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.kernels.base import Columns, Kernel, Matrix, Positive, Rows, Term, mean_square
from mcpilco.kernels.polynomial import MonomialBasis
from mcpilco.typing import InputError


class Map(NamedTuple):
    """The prior of one map h_i: its covariance is scale * S_1 x S_2 x ... x S_i  (eq. 6.34)."""

    scale: Float[Tensor, "*b"]
    """v_i"""
    metrics: tuple[Tensor, ...]
    """S_1, ..., S_i: their diagonals (*b, D), or where they are full (*b, D, D)"""


class VolterraKernel(Kernel):
    """k(x, x') = k_0 + sum_{i=1..degree} v_i prod_{p=1..i} x^T S_ip x', with diagonal S_ip.

    Args:
        width: D, how many lagged inputs it sees.
        degree: r, of the series.
        batch: shape of the hyperparameters, `(E,)` for the E outputs of a GP.

    Reference: thesis eqs. (6.32) to (6.34).
    """

    def __init__(self, width: int, degree: int, batch: Sequence[int] = ()) -> None:
        super().__init__(width, batch)
        if degree < 1:
            raise InputError(f"{type(self).__name__} needs a degree of at least 1, got {degree}.")
        self.degree = degree

    constant = Positive()

    def offset_variance(self) -> Float[Tensor, "*b"]:
        """k_0, the prior variance of h_0."""
        return self.constant

    @abstractmethod
    def maps(self) -> list[Map]:
        """The priors of h_1, ..., h_r; metrics that are equal may be one object."""

    def forward(self, X1: Rows, X2: Columns) -> Matrix:
        return self._total(lambda S: self.times(X1, S) @ X2.mT, 2)

    def diag(self, X: Rows) -> Float[Tensor, "*#b N"]:
        return self._total(lambda S: (self.times(X, S) * X).sum(-1), 1)

    def terms(self) -> list[Term]:
        return self.terms_of(self.maps(), self.width)

    def terms_of(self, maps: Sequence[Map], width: int) -> list[Term]:
        """The kernel with these maps, whose metrics are diagonals of this width."""
        w = torch.zeros(*self.batch, width, dtype=torch.float64)
        constant = Term(self.offset_variance(), w, w[..., :0], w[..., None, :][..., :0, :])
        return [
            constant,
            *(
                Term(v, w, w[..., :1].expand(*self.batch, len(metrics)), torch.stack(metrics, -2))
                for v, metrics in maps
            ),
        ]

    def penalties(self, degree: int) -> Tensor:
        """lambda_h of a map, with an axis of length D for each lag; what is small is penalised.

        The prior variance of a coefficient, averaged over the orders of its lags.

        Args:
            degree: i of h_i, from 1 to r.

        Reference: thesis eq. (6.37).
        """
        scale, metrics = self.maps()[degree - 1]
        ordered = scale[..., None] * reduce(_kron, [self.variances(S) for S in metrics])
        ordered = ordered.reshape(*self.batch, *[self.width] * degree)
        return symmetric(ordered, degree)

    def weight_covariance(self, basis: MonomialBasis) -> Float[Tensor, "*b F F"]:
        """Lambda, with k(x, x') = phi(x)^T Lambda phi(x') for the monomials phi of a basis.

        Args:
            basis: of the kernel's width and degree.

        Reference: thesis eqs. (6.21) and (6.27).
        """
        blocks = [self.offset_variance()[..., None, None]]
        for count, places, (scale, metrics) in zip(
            basis.counts[1:], basis.places, self.maps(), strict=True
        ):
            blocks.append(scale[..., None, None] * self.collected(metrics, places, count))
        return _block_diagonal(blocks)

    # What differs where the metrics are full:

    def times(self, X: Rows, S: Tensor) -> Rows:
        """X S."""
        return X * S[..., None, :]

    def variances(self, S: Tensor) -> Float[Tensor, "*b D"]:
        """The diagonal of S."""
        return S

    def collected(self, metrics: Sequence[Tensor], places: Tensor, count: int) -> Tensor:
        """S_1 x ... x S_i, summed over the orders of the lags of each monomial."""
        ordered = reduce(_kron, metrics)
        collected = ordered.new_zeros(*self.batch, count).index_add(-1, places, ordered)
        return collected.diag_embed()

    def _total(self, inner: Callable[[Tensor], Tensor], axes: int) -> Tensor:
        """k_0 + sum_i v_i prod_p inner(S_ip), each different inner(S) found once."""
        maps = self.maps()
        metrics = {id(S): S for _, many in maps for S in many}
        known = {key: inner(S) for key, S in metrics.items()}
        behind = (..., *[None] * axes)
        total = self.offset_variance()[behind]
        for scale, many in maps:
            total = total + scale[behind] * reduce(mul, (known[id(S)] for S in many))
        return total

    def shares(
        self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]
    ) -> tuple[Float[Tensor, "*b"], list[Tensor]]:
        """k_0, and the factor of each v_i, with which all explain equal shares of Y."""
        share = mean_square(Y) / (self.degree + 1)
        present = [
            scale * reduce(mul, ((self.times(X, S) * X).sum(-1) for S in metrics)).mean(-1)
            for scale, metrics in self.maps()
        ]
        return share, [share / mean for mean in present]


def degrees(degree: int) -> list[int]:
    """How many factors each map has: 1, 2, ..., degree."""
    return list(range(1, degree + 1))


def later(degree: int) -> Float[Tensor, "F F"]:
    """The matrix that sums each map's factors backwards, all maps below one another (6.28)."""
    return torch.block_diag(*(torch.ones(i, i).double().triu() for i in degrees(degree)))


def symmetric(tensor: Tensor, axes: int) -> Tensor:
    """The mean over all orders of the last axes."""
    first = tensor.ndim - axes
    kept = tuple(range(first))
    orders = [
        tensor.permute(*kept, *(first + a for a in order)) for order in permutations(range(axes))
    ]
    return torch.stack(orders).mean(0)


def _kron(a: Float[Tensor, "*b A"], b: Float[Tensor, "*b D"]) -> Float[Tensor, "*b AD"]:
    return (a[..., :, None] * b[..., None, :]).flatten(-2)


def _block_diagonal(blocks: Sequence[Tensor]) -> Float[Tensor, "*b F F"]:
    sizes = [block.shape[-1] for block in blocks]
    total, end = blocks[0].new_zeros(*blocks[0].shape[:-2], sum(sizes), sum(sizes)), 0
    for size, block in zip(sizes, blocks, strict=True):
        total[..., end : end + size, end : end + size] = block
        end += size
    return total
