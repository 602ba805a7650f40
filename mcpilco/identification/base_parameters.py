"""Which parameters, and which sums of parameters, the forces depend on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import qr, solve_triangular

TOLERANCE = 1e-9
"""relative size of a column of R below which it depends on those before"""
ROUNDING = 1e-12
"""length of a column, relative to the longest, below which it is 0"""


@dataclass(frozen=True)
class BaseParameters:
    """Columns of a regressor that are independent, and how the others depend on them.

        Y theta = Y[:, independent] beta,    beta = theta[independent] + K theta[dependent]

    so that forces tell beta and nothing else.

    Reference: Gautier, Numerical calculation of the base inertial parameters of robots, J. Robotic
    Systems 8 (4), 1991.
    """

    independent: Int[np.ndarray, " B"]
    """ascending"""
    dependent: Int[np.ndarray, " R"]
    """ascending; also those that no force depends on"""
    K: Float[np.ndarray, "B R"]
    """0 where beta does not depend on a parameter"""

    def __len__(self) -> int:
        return len(self.independent)

    def of(self, theta: Float[np.ndarray, " D"]) -> Float[np.ndarray, " B"]:
        """beta, in the units of the independent parameters."""
        return theta[self.independent] + self.K @ theta[self.dependent]

    def columns(self, Y: Float[np.ndarray, "*b D"]) -> Float[np.ndarray, "*b B"]:
        """The independent columns of a regressor."""
        return Y[..., self.independent]

    def lift(self, beta: Float[np.ndarray, " B"]) -> Float[np.ndarray, " D"]:
        """The theta that has these base parameters, 0 for all dependent parameters."""
        theta = np.zeros(len(self.independent) + len(self.dependent))
        theta[self.independent] = beta
        return theta

    def near(
        self, beta: Float[np.ndarray, " B"], theta: Float[np.ndarray, " D"]
    ) -> Float[np.ndarray, " D"]:
        """The parameters that have these base parameters, and theta's dependent parameters."""
        found = theta.copy()
        found[self.independent] = beta - self.K @ theta[self.dependent]
        return found

    def formulas(self, names: tuple[str, ...], least: float = 1e-6) -> tuple[str, ...]:
        """Each base parameter as a sum of parameters, for readers.

        Args:
            names: of the D parameters.
            least: size of a factor that is told [units of the quotient].
        """
        found = []
        for row, first in zip(self.K, self.independent, strict=True):
            parts = [
                f"{'+' if factor > 0 else '-'} {abs(factor):.4g} {names[other]}"
                for factor, other in zip(row, self.dependent, strict=True)
                if abs(factor) > least
            ]
            found.append(" ".join([names[first], *parts]))
        return tuple(found)


def base_parameters(Y: Float[np.ndarray, "*b D"], tolerance: float = TOLERANCE) -> BaseParameters:
    """The base parameters of a regressor, by a QR factorisation without pivots.

    Of dependent columns the first stays. With Y of random `motions` they are those of the robot;
    with Y of a recording those that the recording can tell.

    Args:
        Y: rows of any number of samples and joints, more than D of them.
        tolerance: what is left of a column, relative to its length, when it is told by others.
    """
    rows = Y.reshape(-1, Y.shape[-1])
    length = np.linalg.norm(rows, axis=0)
    felt = length > ROUNDING * length.max(initial=0.0)
    scale = np.where(felt, length, np.inf)
    T, kept = _echelon(qr(rows / scale, mode="r")[0][: Y.shape[-1]], tolerance)
    others = np.setdiff1d(np.arange(T.shape[1]), kept)
    K = solve_triangular(T[: len(kept), kept], T[: len(kept), others])
    return BaseParameters(kept, others, K * (length * felt)[others] / length[kept][:, None])


def _echelon(
    rows: Float[np.ndarray, "M D"], tolerance: float
) -> tuple[Float[np.ndarray, "M D"], Int[np.ndarray, " B"]]:
    """Q^T rows in echelon form, and the columns in which its steps are: Householder's reflections.

    A column that is dependent takes no step, so none of the later ones is divided by next to 0.
    """
    T = rows.copy()
    kept: list[int] = []
    for column in range(T.shape[1]):
        v = T[len(kept) :, column].copy()
        size = np.linalg.norm(v)
        if size > tolerance:
            v[0] += np.copysign(size, v[0])
            v /= np.linalg.norm(v)
            T[len(kept) :] -= 2.0 * np.outer(v, v @ T[len(kept) :])
            kept.append(column)
    return T, np.array(kept, dtype=int)
