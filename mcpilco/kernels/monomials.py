"""Polynomial kernels as finitely many features."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import comb
from operator import mul

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mcpilco.kernels.base import Term


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
