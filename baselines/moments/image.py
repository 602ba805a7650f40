"""The image of a Gaussian under a function, and how such functions follow one another.

    x ~ N(m, s),   y = f(x):   M = E[y],   S = cov(y),   V = s^-1 cov(x, y)

V is defined for singular s too: by Stein's lemma it is E[df/dx].

Reference: Deisenroth, Fox & Rasmussen, IEEE Transactions on Pattern Analysis and Machine
Intelligence 37 (2), 2015 (PILCO; here: DFR), on exact moment matching.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Image:
    """The first two moments of y = f(x) for a Gaussian x."""

    mean: Float[Tensor, "*b E"]
    """M"""
    cov: Float[Tensor, "*b E E"]
    """S, all outputs against all"""
    slope: Float[Tensor, "*b D E"]
    """V = s^-1 cov(x, y), the mean slope of f"""

    def mapped(self, W: Float[Tensor, "F E"]) -> Image:
        """The moments of W y."""
        return Image(self.mean @ W.mT, W @ self.cov @ W.mT, self.slope @ W.mT)


@dataclass(frozen=True)
class Gaussian:
    """A Gaussian over a growing vector: a state, then what functions make of parts of it."""

    mean: Float[Tensor, "*b J"]
    """of each entry, in its unit"""
    cov: Float[Tensor, "*b J J"]
    """of all entries"""

    @property
    def width(self) -> int:
        """J."""
        return self.mean.shape[-1]

    def part(self, entries: Sequence[int]) -> tuple[Float[Tensor, "*b D"], Float[Tensor, "*b D D"]]:
        """Mean and covariance of some entries."""
        chosen = list(entries)
        return self.mean[..., chosen], self.cov[..., chosen, :][..., chosen]

    def joined(self, entries: Sequence[int], image: Image) -> Gaussian:
        """The vector with the function's outputs behind it, as if all were Gaussian together.

        An entry z is correlated with y through the function's inputs x: cov(z, y) = cov(z, x) V.

        Reference: DFR on trajectory prediction: the chain of cross-covariances.
        """
        cross = self.cov[..., list(entries)] @ image.slope
        upper = torch.cat([self.cov, cross], -1)
        lower = torch.cat([cross.mT, image.cov], -1)
        return Gaussian(torch.cat([self.mean, image.mean], -1), torch.cat([upper, lower], -2))

    def mapped(self, A: Float[Tensor, "F J"]) -> Gaussian:
        """The distribution of A z; its covariance is symmetric to the last digit."""
        cov = A @ self.cov @ A.mT
        return Gaussian(self.mean @ A.mT, 0.5 * (cov + cov.mT))


def through_sine(mean: Float[Tensor, "*b K"], cov: Float[Tensor, "*b K K"]) -> Image:
    """The moments of sin(x), entry by entry.

    With A_kl = (s_kk + s_ll) / 2,

        M_k  = exp(-s_kk / 2) sin m_k,    V_kk = exp(-s_kk / 2) cos m_k
        S_kl = 1/2 exp(-A_kl) [(exp(s_kl) - 1) cos(m_k - m_l) - (exp(-s_kl) - 1) cos(m_k + m_l)]

    The covariance s [rad^2] of the mean m [rad] may be singular or zero.

    By the moment generating function of a Gaussian at imaginary arguments.

    Reference: DFR on squashing.
    """
    variance = cov.diagonal(dim1=-2, dim2=-1)
    shrink = torch.exp(-0.5 * variance)
    A = 0.5 * (variance[..., :, None] + variance[..., None, :])
    same = _shrunk_growth(cov, A) * torch.cos(mean[..., :, None] - mean[..., None, :])
    opposite = _shrunk_growth(-cov, A) * torch.cos(mean[..., :, None] + mean[..., None, :])
    slope = torch.diag_embed(shrink * mean.cos())
    return Image(shrink * mean.sin(), 0.5 * (same - opposite), slope)


def _shrunk_growth(x: Float[Tensor, "*b"], A: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """exp(-A) (exp(x) - 1) for |x| <= A: exact for small x, and no overflow for large."""
    falling = torch.exp(-A) * torch.expm1(x.clamp(max=0.0))
    rising = -torch.exp(x - A) * torch.expm1(-x.clamp(min=0.0))
    return torch.where(x > 0, rising, falling)


def through_waves(
    mean: Float[Tensor, "*b D"],
    cov: Float[Tensor, "*b D D"],
    L: Float[Tensor, "K D"],
    shift: Float[Tensor, " K"],
    W: Float[Tensor, "E K"],
) -> Image:
    """The moments of W sin(L x + shift)."""
    inner = through_sine(mean @ L.mT + shift, L @ cov @ L.mT)
    image = Image(inner.mean, inner.cov, L.mT @ inner.slope)
    return image.mapped(W)


def through_trig(
    mean: Float[Tensor, "*b D"], cov: Float[Tensor, "*b D D"], angles: Sequence[int]
) -> Image:
    """The moments of (sin q_1, cos q_1, sin q_2, cos q_2, ...) of some entries q of x [rad].

    As cos q = sin(q + pi / 2), all are sines.
    """
    twice = [angle for angle in angles for _ in range(2)]
    L = torch.eye(mean.shape[-1], dtype=mean.dtype)[twice]
    shift = mean.new_tensor([0.0, math.pi / 2] * len(angles))
    return through_waves(mean, cov, L, shift, torch.eye(len(twice), dtype=mean.dtype))


def through_squash(
    mean: Float[Tensor, "*b U"], cov: Float[Tensor, "*b U U"], limit: Float[Tensor, " U"]
) -> Image:
    """The moments of limit (9 sin a + sin 3a) / 8, which stays within +-limit.

    Reference: DFR on squashing.
    """
    eye = torch.eye(mean.shape[-1], dtype=mean.dtype)
    L = torch.cat([eye, 3.0 * eye])
    W = torch.cat([9.0 / 8.0 * torch.diag(limit), 1.0 / 8.0 * torch.diag(limit)], 1)
    return through_waves(mean, cov, L, L.new_zeros(len(L)), W)
