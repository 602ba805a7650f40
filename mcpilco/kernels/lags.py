"""Priors over Volterra series: PK, IPK and MPK weight each lag, SEDMPK makes maps smooth."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from math import comb

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.kernels.base import Canonical, Kernel, Positive, Rows, Term, mean_square
from mcpilco.kernels.volterra import Map, VolterraKernel, degrees, later
from mcpilco.typing import InputError


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


_START_DECAY = 3.0
_START_DECORRELATION = 10.0
"""where fits start, over all lags together [-]: variances fall to exp(-2 * 3), and neighbours a
tenth of the lags apart are correlated by exp(-1)"""


class SEDMPK(VolterraKernel):
    """k(x, x') = k_0 + sum_{i=1..degree} scales_i prod_{p=1..i} x^T S_p x', with full S_p.

        S_p(t, t') = exp(-decorrelation_p |t - t'| - decay_p (t + t')),    t, t' = 0, ..., lags

    Of several inputs ("channels") each has its own decorrelation and decay, and a weight; x holds
    all lags of the first, then all of the second, ..., and S_p has a block for each. Where other
    regressors stand beside the lags, wrap the kernel in `ActiveDims`.

    Args:
        width: D = channels (lags + 1).
        degree: r, of the series.
        batch: shape of the hyperparameters, `(E,)` for the E outputs of a GP.
        channels: how many inputs.
        hierarchical: each factor of each degree has its own S_p, ordered as those of `VolterraMPK`;
            by default all are one, which is cheaper, and what the thesis measured.

    Reference: thesis eqs. (6.29), (6.30) and (6.35); the hierarchy as in (6.28).
    Differs: the thesis has one input.
    """

    decay_steps = Positive()
    """[1/sample]"""
    decorrelation_steps = Positive()
    """[1/sample]"""
    scales = Positive()
    channel_weights = Positive()
    _later: Tensor
    _lag: Tensor
    _channel: Tensor

    def __init__(
        self,
        width: int,
        degree: int,
        batch: Sequence[int] = (),
        *,
        channels: int = 1,
        hierarchical: bool = False,
    ) -> None:
        super().__init__(width, degree, batch)
        if channels < 1 or width % channels:
            raise InputError(
                f"SEDMPK needs as many lags of each of its {channels} channels, got a width of "
                f"{width}; give channels * (lags + 1)."
            )
        self.channels, self.hierarchical = channels, hierarchical
        lags, d = width // channels, torch.arange(width)
        self.register_buffer("_lag", (d % lags).double(), persistent=False)
        self.register_buffer("_channel", d // lags, persistent=False)
        one = torch.ones(1, 1, dtype=torch.float64)
        self.register_buffer("_later", later(degree) if hierarchical else one, persistent=False)
        self.decay_steps = self.spread(_START_DECAY / lags, len(self._later), channels)
        self.decorrelation_steps = self.spread(
            _START_DECORRELATION / lags, len(self._later), channels
        )
        self.scales = self.spread(1.0, degree)
        if channels > 1:
            self.channel_weights = self.spread(1.0, channels)
        self.constant = self.spread(1.0)

    @property
    def decay(self) -> Float[Tensor, "*b factors channels"]:
        """beta_p of the factors of degree 1, then those of degree 2, ...; one if shared."""
        return self._later @ self.decay_steps

    @property
    def decorrelation(self) -> Float[Tensor, "*b factors channels"]:
        """alpha_p, likewise."""
        return self._later @ self.decorrelation_steps

    def maps(self) -> list[Map]:
        return self._maps(self._metrics().unbind(-3))

    def _maps(self, factors: tuple[Tensor, ...]) -> list[Map]:
        """The maps, given the metric of each factor."""
        scales = self.scales.unbind(-1)
        if not self.hierarchical:
            return [Map(v, factors * i) for i, v in enumerate(scales, 1)]
        firsts = [i * (i - 1) // 2 for i in degrees(self.degree)]
        return [
            Map(v, factors[first : first + i])
            for i, (v, first) in enumerate(zip(scales, firsts, strict=True), 1)
        ]

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Every degree explains an equal share."""
        lags = self.width // self.channels
        counts = [i for i in degrees(self.degree) for _ in range(i)] if self.hierarchical else [1]
        steps = 1.0 / lags / torch.tensor(counts).double()[:, None]
        self.decay_steps = self.spread(_START_DECAY * steps, len(steps), self.channels)
        self.decorrelation_steps = self.spread(
            _START_DECORRELATION * steps, len(steps), self.channels
        )
        self.scales = self.spread(1.0, self.degree)
        if self.channels > 1:
            power = (
                torch.zeros(self.channels).double().index_add(0, self._channel, X.square().mean(0))
            )
            power = torch.where(power > 0, power, torch.ones_like(power))
            self.channel_weights = self.spread(power.mean() / power, self.channels)
        self.constant, shares = self.shares(X, Y)
        self.scales = torch.stack(shares, -1)

    def terms(self) -> list[Term]:
        return Kernel.terms(self)

    def canonical(self) -> Canonical:
        """S_p = A_p A_p^T: each factor is an inner product of combinations x^T A_p.

        Each entry of the batch has combinations of its own, which the terms of others do not see.
        """
        A = self._roots()
        W = A.movedim(-2, 0).flatten(1)
        own = torch.eye(W.shape[1], dtype=W.dtype).reshape(*A.shape[:-1], -1).sum(-2)
        seen = torch.nn.functional.pad(own, (self.width, 0))
        return Canonical(W, self.terms_of(self._maps(seen.unbind(-2)), sum(W.shape)))

    def times(self, X: Rows, S: Tensor) -> Rows:
        return X @ S

    def variances(self, S: Tensor) -> Float[Tensor, "*b D"]:
        return S.diagonal(dim1=-2, dim2=-1)

    def collected(self, metrics: Sequence[Tensor], places: Tensor, count: int) -> Tensor:
        ordered = reduce(_kron, metrics)
        rows = ordered.new_zeros(*self.batch, count, len(places)).index_add(-2, places, ordered)
        return rows.new_zeros(*self.batch, count, count).index_add(-1, places, rows)

    def _metrics(self) -> Float[Tensor, "*b factors D D"]:
        """S_p, all factors below one another."""
        lag, channel = self._lag, self._channel
        apart, together = (lag[:, None] - lag).abs(), lag[:, None] + lag
        alpha = self.decorrelation[..., channel, None]
        beta = self.decay[..., channel, None]
        S = torch.exp(-alpha * apart - beta * together)
        return S if self.channels == 1 else S * self._weights() * (channel[:, None] == channel)

    def _roots(self) -> Float[Tensor, "*b factors D D"]:
        """A_p of S_p = A_p A_p^T, all factors below one another.

            A_p(t, j) = exp(-decay_p t - decorrelation_p (t - j)) r_j,    j <= t,

        with r_0 = 1 and r_j^2 = 1 - exp(-2 decorrelation_p): the maps are autoregressive processes
        of first order that decay, and j counts what is new at each lag.
        """
        lag, channel = self._lag, self._channel
        since = lag[:, None] - lag
        alpha = self.decorrelation[..., channel, None]
        beta = self.decay[..., channel, None]
        new = torch.where(lag > 0, -torch.expm1(-2.0 * alpha), 1.0).sqrt()
        A = torch.exp(-alpha * since.clamp(min=0.0) - beta * lag[:, None]) * new * (since >= 0.0)
        if self.channels == 1:
            return A
        return A * self._weights().sqrt() * (channel[:, None] == channel)

    def _weights(self) -> Float[Tensor, "*b 1 D 1"]:
        """The weight of the channel of each lag."""
        return self.channel_weights[..., None, self._channel, None]


def _kron(a: Float[Tensor, "*b A A"], b: Float[Tensor, "*b D D"]) -> Float[Tensor, "*b AD AD"]:
    return (a[..., :, None, :, None] * b[..., None, :, None, :]).flatten(-2).flatten(-3, -2)
