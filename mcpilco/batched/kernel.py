"""The kernels of S seeds as matrices: what a row k(x, X) and its derivative are products of.

A kernel is a sum of K terms v exp(-1/2 |x - x_j|^2_w) prod_f (c_f + <x, x_j>_s_f). Each exponent
and each factor is a "group": linear in [x - middle, 1] but for a part that depends on x alone, and
so one product of [x - middle, 1, shifts] with a constant matrix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import count

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.batched.transfer import Movable
from mcpilco.kernels.base import Kernel, Term


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
    """where groups are expanded: exponents lose digits far from it"""
    expand: Float[Tensor, "G S E C N"]
    """from [x - middle, 1, shifts] to each group"""
    collect: Float[Tensor, "G S E N D_plus_1"]
    """from a weighted group to the sum of its slopes, and its mass"""
    w: Float[Tensor, "exponents S E 1 D"]
    """inverse squared lengthscales of each exponent"""
    v: Float[Tensor, "exponents S E 1"]
    """scale of each term with an exponent"""
    c: Float[Tensor, "S E 1 F"]
    """offset of each factor; the scale of a term without exponent is in its first factor"""
    s: Float[Tensor, "S E F D"]
    """weights of each factor"""

    @property
    def exponents(self) -> int:
        """How many groups are exponents."""
        return len(self.w)

    def groups(self, x: Float[Tensor, "S P D"]) -> Float[Tensor, "G S E P N"]:
        """All groups at the particles' regressors; exponents as their exponentials.

            -1/2 |x - x_j|^2_w = <x - middle, m_j>_w - 1/2 |m_j|^2_w - 1/2 |x - middle|^2_w

        with m_j = x_j - middle; the last part is the shift.
        """
        off = (x - self.middle)[:, None]
        shifts = -0.5 * (self.w * off.square()).sum(-1)
        off = off.expand(*shifts.shape[1:], -1)
        columns = torch.cat([off, torch.ones_like(off[..., :1]), shifts.movedim(0, -1)], -1)
        groups = columns @ self.expand
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
                weighted[term.exponent] = _product([g, *(groups[i] for i in term.all)])
            for f in term.factors:
                weighted[f] = _product([g, *(groups[i] for i in term.all if i != f)])
        moments = weighted @ self.collect
        mass = moments[: self.exponents, ..., -1:]
        off = (x - self.middle)[:, None]
        return moments[..., :-1].sum(0) - (self.w * mass).sum(0) * off

    def prior(
        self, x: Float[Tensor, "S P D"]
    ) -> tuple[Float[Tensor, "S E P"], Float[Tensor, "S E P D"]]:
        """k(x, x), and its derivative."""
        squares = self.c + x.square()[:, None] @ self.s.mT
        weights = torch.empty_like(squares)
        values = []
        first = self.exponents
        for term in self.terms:
            scale = [] if term.exponent is None else [self.v[term.exponent]]
            factors = {f: squares[..., f - first] for f in term.factors}
            values.append(_product([*scale, *factors.values()]).expand(squares.shape[:-1]))
            for f in term.factors:
                others = [factor for i, factor in factors.items() if i != f]
                weights[..., f - first] = _product([*scale, *others]) if scale or others else 1.0
        return reduce(torch.add, values), 2 * x[:, None] * (weights @ self.s)


@torch.no_grad()
def kernel_batch(
    kernels: Sequence[Kernel], X: Float[Tensor, "S N D"], known: Bool[Tensor, "S N"]
) -> KernelBatch:
    """The arrays of kernels of one structure.

    Args:
        kernels: of each seed.
        X: samples of each seed; rows that are not known are zero.
        known: which rows are samples; for the others every slope and offset is zero.
    """
    terms = [_ready(term) for term in _stacked(kernels)]
    bells = torch.tensor([_has_exponent(term) for term in terms])
    w = torch.stack([term.w for term in terms])[bells, ..., None, :]
    v = torch.stack([term.v for term in terms])[bells, ..., None]
    c, s = torch.cat([term.c for term in terms], -1), torch.cat([term.s for term in terms], -2)
    middle = X.sum(1, keepdim=True) / known.sum(1)[:, None, None]
    real = known[:, None, None].to(X.dtype)
    m = (X - middle).mT[:, None] * real
    # the scale of a term with an exponent rides on its offset: one pass less over the matrix
    offset = v.log()[..., None] - 0.5 * (w.mT * m.square()).sum(-2, keepdim=True)
    factors = s.movedim(-2, 0)[..., None] * X.mT[:, None]
    offset_of_factors = c.movedim(-1, 0)[..., None, None] + middle[:, None] @ factors
    slope = torch.cat([w.mT * m, factors])
    offset = torch.cat([offset, offset_of_factors]) * real
    own = torch.eye(len(slope), len(w), dtype=X.dtype)[:, None, None, :, None]
    shifts = own.expand(-1, *offset.shape[1:3], -1, offset.shape[-1])
    return KernelBatch(
        terms=_numbered(terms),
        middle=middle,
        expand=torch.cat([slope, offset, shifts], -2),
        collect=torch.cat([slope, torch.ones_like(offset)], -2).mT.contiguous(),
        w=w,
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
