"""How noisy the inputs of a regression are, from the recording alone."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from mcpilco.typing import InputError


def noise_of_repetitions(X: Float[np.ndarray, "R T D"]) -> Float[np.ndarray, "D D"]:
    """Covariance of an input row's noise, from R repetitions of one motion.

    What differs between the repetitions at one time is noise. The mean over repetitions has 1 / R
    of it.

    Args:
        X: inputs of the same T times of each repetition.

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

    Args:
        X: inputs on a uniform grid.
        dt: its step [s].
        cutoff: frequency that no motion reaches [Hz].

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
