"""The noise of readings: correlated from one to the next, beside disturbances in few directions.

A sensor's filter, or the jitter of its time stamps, lets a part of each error go over to the next
reading. Taken as white, such noise of a velocity looks like a force.

Reference: Ljung, System Identification (1999), section 4.2, for noise as white noise filtered.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float


class NoiseFilter(NamedTuple):
    """Makes noise white that goes over, in part, from each reading to the next: AR(1).

    A reading without one right before it begins anew.
    """

    a: Float[np.ndarray, "W n"]
    """one over the std of what is new in each reading's noise [reported noise]"""
    f: Float[np.ndarray, "W n"]
    """part of the noise before that goes over [-]"""

    @classmethod
    def of(
        cls,
        seen: Bool[np.ndarray, "W X T"],
        noise: Float[np.ndarray, " X"],
        correlation: Float[np.ndarray, " X"],
    ) -> NoiseFilter:
        """That of readings with such noise [reported noise] and correlation [-] of each state."""
        f = np.where(following(seen), correlation[:, None], 0.0)
        a = 1.0 / (noise[:, None] * np.sqrt(1.0 - f**2))
        return cls(a.reshape(len(seen), -1), f.reshape(len(seen), -1))

    def __call__(self, r: Float[np.ndarray, "... W n"]) -> Float[np.ndarray, "... W n"]:
        """Residuals with white noise."""
        white = np.array(r)
        white[..., 1:] -= self.f[:, 1:] * r[..., :-1]
        white *= self.a
        return white

    def columns(self, A: Float[np.ndarray, "W n m"]) -> Float[np.ndarray, "W n m"]:
        """The same of each column."""
        return self(A.transpose(2, 0, 1)).transpose(1, 2, 0)


def following(seen: Bool[np.ndarray, "W X T"]) -> Bool[np.ndarray, "W X T"]:
    """Which readings have one right before them."""
    return seen & np.concatenate([np.zeros_like(seen[..., :1]), seen[..., :-1]], axis=-1)


class Whitening(NamedTuple):
    """The inverse root (I - U diag(c) U^T) F of the covariance of residuals."""

    F: NoiseFilter
    """of the noise"""
    U: Float[np.ndarray, "W n m"]
    """orthonormal directions in which random forces move a window's measurements"""
    c: Float[np.ndarray, "W m"]
    """part of each that is taken off [-]"""

    def __call__(self, r: Float[np.ndarray, "... W n"]) -> Float[np.ndarray, "... W n"]:
        """White residuals."""
        flat = self.F(r).reshape(-1, *self.U.shape[:2]).transpose(1, 0, 2)  # (W, S, n)
        coloured = (self.c[:, None] * (flat @ self.U)) @ self.U.transpose(0, 2, 1)
        return (flat - coloured).transpose(1, 0, 2).reshape(r.shape)

    def of(self, chosen: Any) -> Whitening:
        """That of some windows."""
        F = NoiseFilter(self.F.a[chosen], self.F.f[chosen])
        return Whitening(F, self.U[chosen], self.c[chosen])
