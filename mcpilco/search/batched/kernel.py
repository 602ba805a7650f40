"""The kernels of S seeds as matrices: what a row k(x, X) and its derivative are products of.

A kernel is a sum of K terms v exp(-1/2 |x - x_j|^2_w) prod_f (c_f + <x, x_j>_s_f). Each exponent
and each factor is a "group": linear in the powers [1, x, x^2], and so one product of these with a
constant matrix. The derivative is a product with the same matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import count

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.kernels import Kernel, Term
from mcpilco.search.batched.powers import powers
from mcpilco.search.batched.transfer import Movable


@dataclass(frozen=True)
class Groups:
    """The groups that one term is the product of, by number."""

    exponent: int | None
    """the group whose exponential is a factor; it carries the scale v too"""
    factors: tuple[int, ...]
    """the groups that are factors as they are"""

    @property
    def all(self) -> tuple[int, ...]:
        """Exponent and factors."""
        return self.factors if self.exponent is None else (self.exponent, *self.factors)


@dataclass(frozen=True)
class KernelBatch(Movable):
    """E kernels of each of S seeds, and the N samples that they are evaluated against."""

    terms: tuple[Groups, ...]
    """what each term is made of; exponents are the first groups"""
    middle: Float[Tensor, "S 1 D"]
    """where x is measured from: exponents lose digits far from it"""
    expand: Float[Tensor, "G S E one_plus_two_D N"]
    """from the powers of x - middle to each group"""
    v: Float[Tensor, "exponents S E 1"]
    """scale of each term with an exponent"""
    c: Float[Tensor, "S E 1 F"]
    """offset of each factor; the scale of a term without exponent is in its first factor"""
    s: Float[Tensor, "S E F D"]
    """weights of each factor"""

    @property
    def exponents(self) -> int:
        """How many groups are exponents."""
        return len(self.v)

    def groups(self, x: Float[Tensor, "S P D"]) -> Float[Tensor, "G S E P N"]:
        """All groups at the particles' regressors; exponents as their exponentials."""
        groups = powers(x - self.middle)[:, None] @ self.expand
        groups[: self.exponents].exp_()
        return groups

    def row(self, groups: Float[Tensor, "G S E P N"]) -> Float[Tensor, "S E P N"]:
        """k(x, X)."""
        return reduce(torch.add, (_product([groups[i] for i in term.all]) for term in self.terms))

    def slope(
        self,
        x: Float[Tensor, "S P D"],
        groups: Float[Tensor, "G S E P N"],
        g: Float[Tensor, "S E P N"],
    ) -> Float[Tensor, "S E P D"]:
        """sum_j g_j dk(x, x_j)/dx."""
        weighted = torch.empty_like(groups)
        for term in self.terms:
            if term.exponent is not None:
                _multiply(weighted[term.exponent], g, [groups[i] for i in term.all])
            for f in term.factors:
                _multiply(weighted[f], g, [groups[i] for i in term.all if i != f])
        _, first, second = (weighted @ self.expand.mT).sum(0).split([1, *2 * [x.shape[-1]]], -1)
        return first + 2 * (x - self.middle)[:, None] * second

    def prior(
        self, x: Float[Tensor, "S P D"]
    ) -> tuple[Float[Tensor, "S E P"], Float[Tensor, "S E P D"]]:
        """k(x, x), and its derivative."""
        squares = self.c + x.square()[:, None] @ self.s.mT
        first, shape = self.exponents, squares.shape[:-1]
        values, weights = [], []
        for term in self.terms:
            scale = [] if term.exponent is None else [self.v[term.exponent]]
            factors = [squares[..., f - first] for f in term.factors]
            values.append(_product([*scale, *factors]).expand(shape))
            for i in range(len(factors)):
                others = [*scale, *factors[:i], *factors[i + 1 :]]
                weights.append(_product(others).expand(shape) if others else x.new_ones(shape))
        # without factors both are empty
        weighted = torch.stack(weights, -1) if weights else squares
        return reduce(torch.add, values), 2 * x[:, None] * (weighted @ self.s)


@torch.no_grad()
def kernel_batch(
    kernels: Sequence[Kernel], X: Float[Tensor, "S N D"], known: Bool[Tensor, "S N"]
) -> KernelBatch:
    """The arrays of kernels of one structure.

    Args:
        kernels: of each seed.
        X: samples of each seed; rows that are not known are zero.
        known: which rows are samples; the groups of all others are zero.
    """
    terms = [_ready(term) for term in _stacked(kernels)]
    own = torch.tensor([_has_exponent(term) for term in terms])
    w = torch.stack([term.w for term in terms])[own, ..., None, :]
    v = torch.stack([term.v for term in terms])[own, ..., None]
    c, s = torch.cat([term.c for term in terms], -1), torch.cat([term.s for term in terms], -2)
    middle = X.sum(1, keepdim=True) / known.sum(1)[:, None, None]
    m = (X - middle).mT[:, None]
    slope = torch.cat([w.mT * m, s.movedim(-2, 0)[..., None] * X.mT[:, None]])
    bells, factors = slope[: len(w)], slope[len(w) :]
    # the scale of a term with an exponent rides on its constant: one pass less over the matrix
    constant = v.log()[..., None] - 0.5 * (bells * m).sum(-2, keepdim=True)
    constants = torch.cat([constant, c.movedim(-1, 0)[..., None, None] + middle[:, None] @ factors])
    square = torch.cat([(-0.5 * w.mT).expand_as(bells), torch.zeros_like(factors)])
    return KernelBatch(
        terms=_numbered(terms),
        middle=middle,
        expand=torch.cat([constants, slope, square], -2) * known[:, None, None],
        v=v,
        c=c[:, :, None],
        s=s,
    )


def _stacked(kernels: Sequence[Kernel]) -> list[Term]:
    """The terms of the kernels, with the seeds in front."""
    seeds = zip(*(kernel.terms() for kernel in kernels), strict=True)
    parts = (
        zip(*((term.v, term.w, term.c, term.s) for term in same), strict=True) for same in seeds
    )
    return [Term(*map(torch.stack, part)) for part in parts]


def _has_exponent(term: Term) -> bool:
    """A term of neither exponent nor factors is a constant: an exponent with w = 0 carries it."""
    return term.c.shape[-1] == 0 or bool((term.w != 0).any())


def _ready(term: Term) -> Term:
    """The same term; where no exponent can carry its scale, its first factor has it."""
    if _has_exponent(term):
        return term
    c, s = term.c.clone(), term.s.clone()
    c[..., 0] *= term.v
    s[..., 0, :] *= term.v[..., None]
    return Term(torch.ones_like(term.v), term.w, c, s)


def _numbered(terms: Sequence[Term]) -> tuple[Groups, ...]:
    """The groups of each term: exponents are counted first, then factors."""
    exponent, factor = count(), count(sum(map(_has_exponent, terms)))
    return tuple(
        Groups(
            next(exponent) if _has_exponent(term) else None,
            tuple(next(factor) for _ in range(term.c.shape[-1])),
        )
        for term in terms
    )


def _product(parts: Sequence[Tensor]) -> Tensor:
    return reduce(torch.mul, parts)


def _multiply(out: Tensor, g: Tensor, parts: Sequence[Tensor]) -> None:
    """Set `out` to g times the parts, without a copy."""
    if parts:
        torch.mul(g, _product(parts), out=out)
    else:
        out.copy_(g)
