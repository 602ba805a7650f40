"""Linear regression from second moments, also with noise that is known or not shared."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mcpilco.typing import InputError


class UnidentifiedWarning(UserWarning):
    """An estimate rests on an assumption that the data do not test."""


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

        Directions of an eigenvalue of X^T X below `rank`, relative to the largest in columns of
        equal length, are not used.
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


@dataclass(frozen=True)
class Solution:
    """Coefficients of y = X b."""

    b: Float[np.ndarray, " D"]
    converged: bool = True
    """whether the search stopped by its own tolerance; a closed form always does"""
    iterations: int = 0
    """of the search; 0 of a closed form"""
    common_std: float = 0.0
    """relative standard deviation of a factor of all b that the data do not determine [-]"""


def noise_of_repetitions(X: Float[np.ndarray, "R T D"]) -> Float[np.ndarray, "D D"]:
    """Covariance of an input row's noise, from R repetitions of one motion.

    What differs between the repetitions at one time is noise. The mean over repetitions has 1 / R
    of it.

    Raises:
        InputError: there is one repetition only.
    """
    repetitions, times, _ = X.shape
    if repetitions < 2:
        raise InputError("at least 2 repetitions of a motion were expected, got 1.")
    off = (X - X.mean(axis=0)).reshape(repetitions * times, -1)
    return off.T @ off / ((repetitions - 1) * times)


def noise_above(X: Float[np.ndarray, "T D"], dt: float, cutoff: float) -> Float[np.ndarray, "D D"]:
    """Covariance of an input row's noise, from what is faster than any motion.

    The noise is taken to be white, so that frequencies above the cutoff hold as much of it as
    their share of all; the motion is taken to hold nothing there. Filtered inputs are not white:
    then use repetitions.

    X is on a uniform grid of step dt [s]; no motion reaches the frequency `cutoff` [Hz].

    Raises:
        InputError: fewer frequencies than inputs are above the cutoff.

    Differs: from a Fourier transform of X itself, whose ends would leak into all frequencies; a
        Hann window takes them to 0 first.
    """
    T, D = X.shape
    window = np.hanning(T)
    line = np.column_stack([np.ones(T), np.arange(T)])
    level = X - line @ np.linalg.lstsq(line, X, rcond=None)[0]
    spectrum = np.fft.rfft(window[:, None] * level, axis=0)
    fast = spectrum[np.fft.rfftfreq(T, dt) > cutoff]
    if len(fast) < D:
        raise InputError(
            f"cutoff {cutoff:g} Hz leaves {len(fast)} frequencies for {D} inputs; record longer, "
            f"or give a cutoff below {0.5 / dt:g} Hz by far."
        )
    # of white noise, each |spectrum|^2 is the sum of the window's squares times the variance
    return (fast.conj().T @ fast).real / len(fast) / (window**2).sum()


def errors_in_variables(
    moments: Moments,
    noise: Float[np.ndarray, " D"] | Float[np.ndarray, "D D"],
    regularisation: float | None = None,
    rank: float = 1e-10,
) -> Float[np.ndarray, " D"]:
    """b of y = t b + noise, for x = t + noise.

    In coordinates in which X^T X is the identity, least squares is X^T y, and each eigenvector of
    N Psi there, with eigenvalue n, has the share r = 1 - n that is not noise. Least squares is to
    be divided by r; it is multiplied by (1 + regularisation) r / (r^2 + regularisation) instead,
    which is 1 where there is no noise, and by 0 where there is nothing else, r <= 0: a direction
    that the noise hides is left out, not blown up.

    `noise` is Psi, the covariance of the noise of an input row, or its diagonal, in the squared
    units of the inputs; the regularisation is D / N by default, the square of the size of sampling
    errors in r.

    Raises:
        InputError: noise is no covariance of the inputs.

    Warns:
        UnidentifiedWarning: in some direction the noise is as large as the input.

    Reference: Fuller, Measurement error models, 1987, section 2.2; the regularisation is ours.
    """
    D = len(moments.xy)
    Psi = np.diag(noise) if noise.ndim == 1 else noise
    if Psi.shape != (D, D) or np.linalg.eigvalsh(Psi)[0] < -1e-9 * max(np.trace(Psi), 1e-300):
        raise InputError(
            f"noise must be {D} variances or a covariance of {D} inputs, got shape {noise.shape}; "
            "variances are not negative."
        )
    if regularisation is None:
        regularisation = D / moments.N
    values, vectors, length = moments.directions(rank)
    whiten = vectors / np.sqrt(values) / length[:, None]  # columns of X whiten are orthonormal
    shares, turned = np.linalg.eigh(whiten.T @ (moments.N * Psi) @ whiten)
    r = 1.0 - shares
    hidden = int((r <= np.sqrt(regularisation)).sum())
    if hidden:
        warnings.warn(
            f"{hidden} of {len(r)} directions of the inputs are noise and little else, and are "
            "left out; record longer or faster motions, or give less noise.",
            UnidentifiedWarning,
            stacklevel=2,
        )
    factor = np.where(r > 0.0, (1.0 + regularisation) * r / (r**2 + regularisation), 0.0)
    basis = whiten @ turned
    return basis @ (factor * (basis.T @ moments.xy))


def instrumental_variables(
    X: Float[np.ndarray, "N D"],
    y: Float[np.ndarray, " N"],
    Z: Float[np.ndarray, "N D"],
    rank: float = 1e-6,
) -> Float[np.ndarray, " D"]:
    """b of Z^T (y - X b) = 0; of least size where Z and X leave several.

    The instruments Z are X of a simulation, or of another repetition of the same motion. Directions
    of a singular value below `rank`, relative to the largest in columns of equal length, are not
    used.
    """
    if X.shape != Z.shape or len(X) != len(y):
        raise InputError(
            f"an instrument for each input and a row for each y were expected, got X {X.shape}, "
            f"Z {Z.shape} and {len(y)} rows."
        )
    x, z = (np.maximum(np.linalg.norm(A, axis=0), 1e-300) for A in (X, Z))
    U, values, Vt = np.linalg.svd((Z / z).T @ (X / x))
    used = values > rank * values[0]
    return Vt[used].T @ (U[:, used].T @ ((Z / z).T @ y) / values[used]) / x


def refine(
    X: Float[np.ndarray, "N D"],
    y: Float[np.ndarray, " N"],
    simulate: Callable[[Float[np.ndarray, " D"]], Float[np.ndarray, "N D"]],
    start: Float[np.ndarray, " D"],
    steps: int = 20,
    tolerance: float = 1e-4,
) -> Solution:
    """Instruments from a simulation with the parameters found so far, until they come to rest.

    `simulate` makes the regressor of a motion under the same controller and references, with given
    parameters, without noise. The end is where the forces X b change by less than `tolerance` of
    their size, or after so many `steps`.

    Reference: Janot, Vandanjon, Gautier, A generic instrumental variable approach for industrial
        robot identification (IDIM-IV), IEEE Transactions on Control Systems Technology 22 (1),
        2014.
    """
    b = start
    for step in range(1, steps + 1):
        found = instrumental_variables(X, y, simulate(b))
        change = np.linalg.norm(X @ (found - b))
        b = found
        if change <= tolerance * np.linalg.norm(X @ b):
            return Solution(b, True, step)
    return Solution(b, False, steps)
