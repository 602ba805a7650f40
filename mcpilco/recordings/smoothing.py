"""The noise of each channel, from the recording alone, and states without most of it.

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

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy.lib.stride_tricks import sliding_window_view
from scipy.interpolate import CubicHermiteSpline
from scipy.special import gammainc, gammaincinv

from mcpilco.recordings.recording import Recording, bridged


def local_fit(
    offsets: Float[np.ndarray, "G K"], values: Float[np.ndarray, "G K"], order: int
) -> tuple[Float[np.ndarray, "G C"], Float[np.ndarray, "G C"], Float[np.ndarray, " G"]]:
    """Least-squares polynomials of G windows with K samples each; NaN samples do not count.

    The samples are `offsets` from where the polynomial is wanted [steps]; C = order + 1.

    Returns:
        The coefficients (value, slope, ...) at offset 0; their standard deviations for noise of
        standard deviation 1; and the mean square residual per degree of freedom, NaN where there
        is none. All are NaN where fewer than C samples are known.
    """
    known = np.isfinite(values)
    A = offsets[..., None] ** np.arange(order + 1) * known[..., None]
    y = np.where(known, values, 0.0)
    degrees = known.sum(-1) - (order + 1)
    normal = np.einsum("gki,gkj->gij", A, A)
    normal[degrees < 0] = np.eye(order + 1)
    covariance = np.linalg.pinv(normal, hermitian=True)
    coefficients = np.einsum("gij,gkj,gk->gi", covariance, A, y)
    spread = np.sqrt(np.einsum("gii->gi", covariance))
    residual = y - np.einsum("gki,gi->gk", A, coefficients)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_square = np.where(degrees > 0, (residual**2).sum(-1) / degrees, np.nan)
    unknown = degrees < 0
    coefficients[unknown], spread[unknown] = np.nan, np.nan
    return coefficients, spread, mean_square


_DEGREE = 4  # of the polynomials
_SPARE = 2  # degrees of freedom of a window
_KEPT = 0.8  # share of the windows that is not trimmed
_FEWEST_WINDOWS = 10  # windows
_TWICE = 2  # a system of more inputs has no room for each of them twice
_RANK = 1e-6  # relative singular value below which regressors are the same


def noise_std(recording: Recording) -> Float[np.ndarray, " X"]:
    """Standard deviation of each state's noise, in its unit; NaN where it cannot be estimated.

    At least that of the rounding to the channel's resolution, step / sqrt(12). Noise is taken to be
    white: of noise that is correlated from sample to sample, only the part that changes within
    about nine samples is seen.
    """
    rates = {velocity for _, velocity in recording.velocities}
    found = [_noise(recording, k, 1 if k in rates else 2) for k in range(len(recording.measured))]
    steps = np.where(recording.measured, recording.resolution, 0.0)
    return np.where(steps > 0, np.fmax(found, steps / np.sqrt(12.0)), found)


def noise_of(
    recordings: Sequence[Recording],
    known: Mapping[str, float],
    angles: Sequence[int],
    least: float,
) -> Float[np.ndarray, " X"]:
    """Noise std of each state of one machine's recordings: the known one, else their median.

    It is at least that of rounding to the steps in which the values came, and a part of their
    spread: a simulation without noise is no more exact than another integrator.

    Args:
        recordings: with the same states.
        known: std of some states, by name [their unit].
        angles: numbers of the states that may turn round and round.
        least: the least std, as a part of the spread [-].
    """
    noise = np.stack([noise_std(recording) for recording in recordings])
    measured = np.stack([recording.measured for recording in recordings])
    std = np.ones(noise.shape[1])
    for x, name in enumerate(recordings[0].state_names):
        if name in known:
            std[x] = known[name]
        elif measured[:, x].any():
            steps = max(recording.resolution[x] for recording in recordings) / np.sqrt(12.0)
            spread = float(np.nanstd(np.concatenate([r.states[:, x] for r in recordings])))
            spread = min(spread, 1.0) if x in angles else spread  # however often it turned
            std[x] = max(float(np.median(noise[measured[:, x], x])), steps, least * spread, 1e-9)
    return std


def _noise(recording: Recording, channel: int, integrals: int) -> float:
    """Of one state, into which the inputs are integrated once or twice."""
    lags = 2 if recording.inputs.shape[1] <= _TWICE else 1
    width = _DEGREE + 1 + lags * recording.inputs.shape[1] + _SPARE
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
    if known.sum() < _FEWEST_WINDOWS:
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
    powers = np.linspace(-1, 1, width)[:, None] ** np.arange(_DEGREE + 1)
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
        if len(group) < _FEWEST_WINDOWS:
            continue
        kept = group[: int(np.ceil(_KEPT * len(group)))]
        share = len(kept) / len(group)
        half_quantile = gammaincinv(d / 2, min(share, 1 - 1e-9))
        mean = d * gammainc(d / 2 + 1, half_quantile) / share
        total += kept.sum() / mean * d
        weight += len(kept) * d
    return float(np.sqrt(total / weight)) if weight else np.nan


WINDOW_S = 0.12
"""length of the windows [s]; at least 7 samples"""
_ORDER = 3
_FEWEST = 7


def smoothed(
    recording: Recording, window: float = WINDOW_S
) -> tuple[Float[np.ndarray, "T X"], Float[np.ndarray, "T X"]]:
    """States by local cubics, and their standard deviations: where to start a simulation from.

    A velocity without a column is the slope of its position's cubic. No window reaches across a
    gap; at the ends of a segment it lies to one side, and the deviation grows. Where the cubic
    misses the samples by more than their noise, the deviation grows by as much.

    A masked value is filled in where its neighbours allow; windows are `window` long [s].

    Returns:
        States and standard deviations, in each state's unit; NaN within gaps, and where a state has
        neither a column nor a position.
    """
    states = np.full_like(recording.states, np.nan)
    std = np.full_like(recording.states, np.nan)
    noise = noise_std(recording)
    position_of = {velocity: position for position, velocity in recording.velocities}
    width = max(_FEWEST, round(window / recording.dt) // 2 * 2 + 1)
    for segment in recording.segments():
        for k, measured in enumerate(recording.measured):
            source, derivative = (k, 0) if measured else (position_of.get(k, k), 1)
            value, error = _local(recording.states[segment, source], width, noise[source])
            per_step = recording.dt**derivative
            states[segment, k] = value[:, derivative] / per_step
            std[segment, k] = error[:, derivative] / per_step
    return states, std


def _local(
    values: Float[np.ndarray, " T"], width: int, noise: float
) -> tuple[Float[np.ndarray, "T C"], Float[np.ndarray, "T C"]]:
    """Coefficients at each sample and their standard deviations [unit a step^c]."""
    width = min(width, len(values))
    here = np.arange(len(values))
    first = np.clip(here - width // 2, 0, len(values) - width)
    rows = first[:, None] + np.arange(width)
    order = min(_ORDER, width - 1)
    value, spread, mean_square = local_fit((rows - here[:, None]) * 1.0, values[rows], order)
    scale = np.fmax(noise, np.sqrt(mean_square))
    return value, spread * scale[:, None]


def states_at_commands(recording: Recording, holds: int) -> Float[np.ndarray, "n X"]:
    """The states at each command, smoothed from the positions alone; 0 if unknown.

    A measured velocity may have come late out of a filter.
    """
    X = recording.states.shape[1]
    states = np.where(np.arange(X) % 2, np.nan, recording.states)
    pairs = tuple((k, k + 1) for k in range(0, X, 2))
    known = smoothed(replace(recording, states=states, velocities=pairs))[0]
    smooth = np.nan_to_num(bridged(known))
    time = recording.dt * np.arange(len(smooth))
    curve = CubicHermiteSpline(time, smooth[:, 0::2], smooth[:, 1::2])
    at = np.minimum(recording.dt / holds * np.arange(len(smooth) * holds), time[-1])
    return np.stack([curve(at), curve(at, 1)], axis=2).reshape(len(at), X)


def first_state(y: Float[np.ndarray, "X T"], dt: float, std: Float[np.ndarray, " X"]) -> np.ndarray:
    """State at the first sample: a cubic through the first samples of each joint."""
    start = np.zeros(len(y))
    for j in range(len(y) // 2):
        both = y[2 * j : 2 * j + 2]
        fewest = 2 if np.isfinite(both[:, :2]).all() else 4  # samples that tell a cubic
        t = dt * np.arange(min(y.shape[1], max(fewest, round(0.16 / dt))))
        powers = np.stack([t**0, t, t**2, t**3], axis=1)
        slopes = np.stack([0 * t, t**0, 2 * t, 3 * t**2], axis=1)
        q, v = both[:, : len(t)]
        seen, moving = np.isfinite(q), np.isfinite(v)
        rows = np.concatenate([powers[seen] / std[2 * j], slopes[moving] / std[2 * j + 1]])
        goal = np.concatenate([q[seen] / std[2 * j], v[moving] / std[2 * j + 1]])
        start[2 * j : 2 * j + 2] = np.linalg.lstsq(rows, goal, rcond=None)[0][:2]
    return start
