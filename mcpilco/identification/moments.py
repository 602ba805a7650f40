"""All that linear regression needs of data: their second moments."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mcpilco.typing import InputError


@dataclass(frozen=True)
class Moments:
    """Sums over N samples of inputs x and an output y; those of two recordings can be added.

    A regressor's Y (N, J, D) and tau (N, J) are N J samples. Rows are not centred: forces have no
    intercept. Where data have one, take their means off first.
    """

    N: int
    """samples"""
    xx: Float[np.ndarray, "D D"]
    """X^T X"""
    xy: Float[np.ndarray, " D"]
    """X^T y"""
    yy: float
    """y^T y"""

    @classmethod
    def of(cls, X: Float[np.ndarray, "*b D"], y: Float[np.ndarray, "*b"]) -> Moments:
        """Of samples.

        Raises:
            InputError: there are none, or numbers are not finite.
        """
        X, y = X.reshape(-1, X.shape[-1]), y.reshape(-1)
        if len(X) != len(y) or len(y) == 0:
            raise InputError(f"a row of X for each y was expected, got {len(X)} and {len(y)}.")
        found = cls(len(y), X.T @ X, X.T @ y, float(y @ y))
        if not (np.isfinite(found.xx).all() and np.isfinite(found.xy).all()):
            raise InputError("X and y must be finite; leave out rows with gaps.")
        return found

    def __add__(self, other: Moments) -> Moments:
        return Moments(self.N + other.N, self.xx + other.xx, self.xy + other.xy, self.yy + other.yy)

    def residual_variance(self, b: Float[np.ndarray, " D"]) -> float:
        """Mean of (y - x b)^2."""
        return max(float(self.yy - 2.0 * b @ self.xy + b @ self.xx @ b) / self.N, 0.0)

    def least_squares(self, rank: float = 1e-10) -> Float[np.ndarray, " D"]:
        """The b of least |y - X b|, and of least size where several are.

        Args:
            rank: eigenvalue of X^T X, relative to the largest in columns of equal length, below
                which a direction is not used.
        """
        values, vectors, length = self.directions(rank)
        return (vectors / values) @ (vectors.T @ (self.xy / length)) / length

    def directions(
        self, rank: float = 1e-10
    ) -> tuple[Float[np.ndarray, " R"], Float[np.ndarray, "D R"], Float[np.ndarray, " D"]]:
        """Eigenvalues and eigenvectors of X^T X in columns of length 1, and those lengths."""
        length = np.sqrt(np.diag(self.xx))
        length = np.where(length > 1e-12 * length.max(initial=0.0), length, np.inf)
        values, vectors = np.linalg.eigh(self.xx / np.outer(length, length))
        used = values > rank * max(values[-1], 1e-300)
        return values[used], vectors[:, used], length
