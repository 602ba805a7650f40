"""How noisy each channel is, from the recording alone.

In a short window a position is a polynomial in time plus the effect of the inputs, which is known
but for a factor: they act on the acceleration, so a position has their double integral in it and
a velocity their integral. Both are taken at the time of the command and a sample later, which
covers a delay in between. What no such curve explains is noise:

    y = P c + [I u, I u(. - dt)] b + e,    s^2 = |(1 - Q Q^T) y|^2 / degrees of freedom

with Q an orthonormal basis of the regressors and I u the integrals. Windows that something else
disturbs (stick and slip, an impact, a tumbling pole) have the largest residuals; they are trimmed,
and the mean of the rest is corrected for it by the chi-square distribution.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view
from scipy.special import gammainc, gammaincinv

from mcpilco.recordings.recording import Recording

_ORDER = 4  # of the polynomials
_SPARE = 2  # degrees of freedom of a window
_KEPT = 0.8  # share of the windows that is not trimmed
_FEWEST = 10  # windows
_TWICE = 2  # a system of more inputs has no room for each of them twice
_RANK = 1e-6  # relative singular value below which regressors are the same


def noise_std(recording: Recording) -> Float[np.ndarray, " X"]:
    """Standard deviation of each state's noise, in its unit; NaN where it cannot be told.

    At least that of the rounding to the channel's resolution, step / sqrt(12). Noise is taken to be
    white: of noise that is correlated from sample to sample, only the part that changes within
    about nine samples is seen.
    """
    rates = {velocity for _, velocity in recording.velocities}
    found = [_noise(recording, k, 1 if k in rates else 2) for k in range(len(recording.measured))]
    steps = np.where(recording.measured, recording.resolution, 0.0)
    return np.where(steps > 0, np.fmax(found, steps / np.sqrt(12.0)), found)


def _noise(recording: Recording, channel: int, integrals: int) -> float:
    """Of one state, into which the inputs are integrated once or twice."""
    lags = 2 if recording.inputs.shape[1] <= _TWICE else 1
    width = _ORDER + 1 + lags * recording.inputs.shape[1] + _SPARE
    windows, inputs = [], []
    for segment in recording.segments():
        y, u = recording.states[segment, channel], recording.inputs[segment]
        if len(y) < width:
            continue
        before = np.concatenate([u[:1], u[:-1]])
        forces = np.concatenate([u, before], 1) if lags == 2 else u
        windows.append(sliding_window_view(y, width))
        inputs.append(sliding_window_view(forces, width, axis=0))
    if not windows:
        return np.nan
    samples, forces = np.concatenate(windows), np.concatenate(inputs).swapaxes(1, 2)
    known = np.isfinite(samples).all(1)
    if known.sum() < _FEWEST:
        return np.nan
    return _scale(*_residuals(samples[known], forces[known], integrals))


def _residuals(
    samples: Float[np.ndarray, "G K"], inputs: Float[np.ndarray, "G K U"], integrals: int
) -> tuple[Float[np.ndarray, " G"], np.ndarray]:
    """Sums of the squares of what windows keep without their regressors; degrees of freedom."""
    count, width = samples.shape
    response = np.zeros_like(inputs)
    response[:, 1:] = np.cumsum(inputs[:, :-1], 1)  # [steps]
    if integrals == 2:
        moved = response[:, :-1] + inputs[:, :-1] / 2
        response[:, 1:] = np.cumsum(moved, 1)
    powers = np.linspace(-1, 1, width)[:, None] ** np.arange(_ORDER + 1)
    A = np.concatenate([np.broadcast_to(powers, (count, *powers.shape)), response], 2)
    length = np.linalg.norm(A, axis=1, keepdims=True)
    Q, singular, _ = np.linalg.svd(A / np.where(length > 0, length, 1), full_matrices=False)
    used = singular > _RANK
    centred = samples - samples.mean(1, keepdims=True)
    explained = (np.einsum("gki,gk->gi", Q, centred) ** 2 * used).sum(1)
    return np.maximum((centred**2).sum(1) - explained, 0.0), width - used.sum(1)


def _scale(squares: Float[np.ndarray, " G"], degrees: np.ndarray) -> float:
    """sigma, from sums of squares that are sigma^2 times chi-square, but for the largest.

    For chi-square with d degrees of freedom below its quantile x of level p, the mean is
    d F_(d + 2)(x) / p.
    """
    total, weight = 0.0, 0.0
    for d in np.unique(degrees):
        group = np.sort(squares[degrees == d])
        if len(group) < _FEWEST:
            continue
        kept = group[: int(np.ceil(_KEPT * len(group)))]
        share = len(kept) / len(group)
        half_quantile = gammaincinv(d / 2, min(share, 1 - 1e-9))
        mean = d * gammainc(d / 2 + 1, half_quantile) / share
        total += kept.sum() / mean * d
        weight += len(kept) * d
    return float(np.sqrt(total / weight)) if weight else np.nan
