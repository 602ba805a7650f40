"""A Gaussian through sines: angles, and the squashing of inputs into their bounds."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.moments.image import Image


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
