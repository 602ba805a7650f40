"""Priors over Volterra series that weight each lag: PK, IPK and MPK."""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.kernels.base import Positive, mean_square
from mcpilco.kernels.volterra import Map, VolterraKernel, degrees, later


class PK(VolterraKernel):
    """k(x, x') = k_0 + sum_{i=1..degree} (sum_d weights_id x_d x'_d)^i.

    A lag's weight tells how much all monomials of one degree with that lag may matter, whatever
    its power in them.

    Reference: thesis eqs. (6.17) and (6.18).
    """

    weights = Positive()

    def __init__(self, width: int, degree: int, batch: Sequence[int] = ()) -> None:
        super().__init__(width, degree, batch)
        self.weights = self.spread(1.0, degree, width)
        self.constant = self.spread(1.0)

    def maps(self) -> list[Map]:
        one = torch.ones_like(self.constant)
        return [Map(one, (S,) * i) for i, S in enumerate(self.weights.unbind(-2), 1)]

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Every degree explains an equal share, and every lag an equal share of it."""
        self.weights = self.spread(1.0 / mean_square(X), self.degree, self.width)
        self.constant, factors = self.shares(X, Y)
        roots = torch.stack([f.pow(1.0 / i) for i, f in enumerate(factors, 1)], -1)
        self.weights = self.weights * roots[..., None]


class IPK(VolterraKernel):
    """k(x, x') = (offset + sum_d weights_d x_d x'_d)^degree.

    One weight a lag for all degrees: the least flexible of these priors.

    Args:
        width: D, how many lagged inputs it sees.
        degree: r, of the series.
        batch: shape of the hyperparameters, `(E,)` for the E outputs of a GP.
        offset: its value, where it is not to be learned; broadcasts to `batch`.

    Reference: thesis eq. (6.23), which has an offset of 1.
    """

    weights = Positive()
    learned_offset = Positive()
    fixed_offset: Tensor

    def __init__(
        self,
        width: int,
        degree: int,
        batch: Sequence[int] = (),
        offset: float | Tensor | None = None,
    ) -> None:
        super().__init__(width, degree, batch)
        self.weights = self.spread(1.0, width)
        self.learns_offset = offset is None
        if offset is None:
            self.learned_offset = self.spread(1.0)
        else:
            self.register_buffer("fixed_offset", self.spread(offset).clone(), persistent=False)

    @property
    def offset(self) -> Float[Tensor, "*b"]:
        """The factor beside the linear kernel."""
        return self.learned_offset if self.learns_offset else self.fixed_offset

    def offset_variance(self) -> Float[Tensor, "*b"]:
        return self.offset.pow(self.degree)

    def maps(self) -> list[Map]:
        S, r = self.weights, self.degree
        return [Map(comb(r, i) * self.offset.pow(r - i), (S,) * i) for i in range(1, r + 1)]

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Every lag, and the offset, explains an equal share.

        With a given offset the lags get what it leaves, at least as much as it has.
        """
        root = mean_square(Y).pow(1.0 / self.degree)
        self.weights = self.spread(1.0 / mean_square(X) / self.width, self.width)
        if not self.learns_offset:
            self.weights = self.weights * torch.maximum(root - self.offset, self.offset)[..., None]
            return
        self.weights = self.weights * self.width
        self.learned_offset = self.spread(1.0)
        share = (mean_square(Y) / self.diag(X).mean(-1)).pow(1.0 / self.degree)
        self.weights = self.weights * share[..., None]
        self.learned_offset = share


class VolterraMPK(VolterraKernel):
    """k(x, x') = k_0 + sum_{i=1..degree} prod_{p=1..i} sum_d weights_ipd x_d x'_d.

    The factors of a degree are ordered, so that no permutation of them is another optimum: weights
    are sums s_p = a_p + ... + a_i of positive steps a, `weight_steps`. Small a_pd for all p > q
    keep the power of the d-th lag in monomials of degree i at q or below.

    Reference: thesis eqs. (6.24), (6.25) and (6.28); the scales rho_i are part of the steps.
    """

    weight_steps = Positive()
    _later: Tensor

    def __init__(self, width: int, degree: int, batch: Sequence[int] = ()) -> None:
        super().__init__(width, degree, batch)
        self.register_buffer("_later", later(degree), persistent=False)
        self.weight_steps = self.spread(1.0, len(self._later), width)
        self.constant = self.spread(1.0)

    @property
    def weights(self) -> tuple[Float[Tensor, "*b degree D"], ...]:
        """s_p of each degree, from the largest to the smallest."""
        return (self._later @ self.weight_steps).split(degrees(self.degree), -2)

    def maps(self) -> list[Map]:
        one = torch.ones_like(self.constant)
        return [Map(one, weights.unbind(-2)) for weights in self.weights]

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Every degree explains an equal share, and every lag an equal share of each factor."""
        self.weight_steps = self.spread(1.0 / mean_square(X), len(self._later), self.width)
        self.constant, factors = self.shares(X, Y)
        roots = [f.pow(1.0 / i)[..., None].expand(*self.batch, i) for i, f in enumerate(factors, 1)]
        self.weight_steps = self.weight_steps * torch.cat(roots, -1)[..., None]
