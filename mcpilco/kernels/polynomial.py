"""Products of linear kernels, priors over polynomials; and the same as finitely many features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import comb
from operator import mul

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mcpilco.kernels.base import Columns, Kernel, Matrix, Positive, Rows, Term, mean_square
from mcpilco.typing import InputError


@dataclass(frozen=True, eq=False)
class Monomials:
    """Features with sum_f phi_f(x) phi_f(x') = sum of v prod_r (c_r + <x, x'>_s_r), exactly.

    Multiplied out, such terms are a polynomial in the products t_d = x_d x'_d with coefficients
    a_f >= 0, and each of its monomials is a feature: t_1 t_2 = (x_1 x_2) (x'_1 x'_2). There are
    binomial(D + R, R) up to degree R; the tensor product of the factors would have (D + 1)^R.
    """

    entries: Int[Tensor, "R F"]
    """which entries of [1, x] each monomial multiplies"""
    roots: Float[Tensor, "E F"]
    """sqrt(a_f)"""

    @classmethod
    def of(cls, terms: Sequence[Term]) -> Monomials:
        """The features of the sum of these terms, but for their exponential factors."""
        total: dict[tuple[int, ...], Tensor] = {}
        for term in terms:
            _accumulate(total, _expand(term))
        present = {dims: a for dims, a in total.items() if bool(a.any())}
        degree = max(map(len, present))
        rows = [[*(d + 1 for d in dims), *[0] * (degree - len(dims))] for dims in present]
        entries = torch.tensor(rows, dtype=torch.int64).reshape(len(rows), degree).T
        return cls(entries.contiguous(), torch.stack(list(present.values()), -1).sqrt())

    def __call__(self, X: Float[Tensor, "*b 1 M D"]) -> Float[Tensor, "*#b E #M F"]:
        """phi(x); a constant keeps axes of length 1."""
        extended = torch.cat([torch.ones_like(X[..., :1]), X], -1)
        columns = [extended.index_select(-1, entries) for entries in self.entries]
        roots = self.roots[:, None, :]
        return reduce(mul, columns) * roots if columns else roots


def _expand(term: Term) -> dict[tuple[int, ...], Float[Tensor, " E"]]:
    """Coefficients of v prod_r (c_r + sum_d s_rd t_d); (0, 0, 2) stands for t_0^2 t_2."""
    product: dict[tuple[int, ...], Tensor] = {(): term.v}
    for c, s in zip(term.c.unbind(-1), term.s.unbind(-2), strict=True):
        longer: dict[tuple[int, ...], Tensor] = {}
        for dims, a in product.items():
            by_entry = {tuple(sorted((*dims, d))): a * s_d for d, s_d in enumerate(s.unbind(-1))}
            _accumulate(longer, {dims: a * c, **by_entry})
        product = longer
    return product


def _accumulate(total: dict[tuple[int, ...], Tensor], more: dict[tuple[int, ...], Tensor]) -> None:
    for dims, a in more.items():
        total[dims] = total[dims] + a if dims in total else a


class MonomialBasis:
    """All monomials of D regressors up to degree r, each once, without factors before them.

    Args:
        width: D.
        degree: r.
    """

    def __init__(self, width: int, degree: int) -> None:
        self.width, self.degree = width, degree
        blocks, self.places = [torch.zeros(1, degree, dtype=torch.int64)], []
        for i in range(1, degree + 1):
            ordered = torch.cartesian_prod(*[torch.arange(1, width + 1)] * i).reshape(-1, i)
            unique, places = ordered.sort(-1).values.unique(dim=0, return_inverse=True)
            blocks.append(torch.nn.functional.pad(unique, (0, degree - i)))
            self.places.append(places)
        self.counts = [len(block) for block in blocks]
        """how many monomials there are of degree 0, 1, ..., r"""
        self.entries = torch.cat(blocks).T.contiguous()
        """which entries of [1, x] each monomial multiplies, (r, F)"""

    def __call__(self, X: Float[Tensor, "*b N D"]) -> Float[Tensor, "*b N F"]:
        """phi(x)."""
        extended = torch.cat([torch.ones_like(X[..., :1]), X], -1)
        return reduce(mul, (extended.index_select(-1, entries) for entries in self.entries))

    @staticmethod
    def size(width: int, degree: int) -> int:
        """F, how many monomials there are."""
        return comb(width + degree, degree)


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

    def forward(self, X1: Rows, X2: Columns) -> Matrix:
        linear = (X1 * self.weights[..., None, :]) @ X2.mT
        return linear + self.bias[..., None, None] if self.has_bias else linear

    def diag(self, X: Rows) -> Float[Tensor, "*#b N"]:
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

    def forward(self, X1: Rows, X2: Columns) -> Matrix:
        offsets, weights = self.offsets.unbind(-1), self.weights.unbind(-2)
        factors = (
            c[..., None, None] + (X1 * s[..., None, :]) @ X2.mT
            for c, s in zip(offsets, weights, strict=True)
        )
        return reduce(torch.mul, factors)

    def diag(self, X: Rows) -> Float[Tensor, "*#b N"]:
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
