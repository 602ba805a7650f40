"""Maps of what a model misses, over time and over the motion, for the pictures of `gap`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from mcpilco.gap import PlantModel, cut, fit_initial_states, residuals_at, run
from mcpilco.recordings import Recording, smoothed
from mcpilco.typing import InputError

MAP_CELL_S, MAP_WINDOWS = 0.25, 400
"""of a map over time, and from the start of one window to that of the next [s]; windows at most:
long recordings have longer cells"""
FORCE_SPAN_S, FORCE_SPANS = 0.1, 6000
"""over which the missing force is a mean [s]; spans at most: of long recordings not every sample
begins one"""


@dataclass(frozen=True)
class TimeMap:
    """How far a model misses each recording, and when."""

    names: tuple[str, ...]
    """of the R recordings"""
    edges: Float[np.ndarray, " C_plus_1"]
    """ends of the cells, from the beginning of a recording [s]"""
    misfit: Float[np.ndarray, "X R C"]
    """rms over the windows that cover a cell [noise std]; NaN where there is none"""


def time_map(
    model: PlantModel,
    theta: Float[np.ndarray, " p"],
    recordings: Sequence[Recording],
    std: Float[np.ndarray, " X"],
) -> TimeMap:
    """The misfit of windows with fitted starts, at the time that they cover.

    Args:
        model: what is judged.
        theta: its parameters.
        recordings: of one sampling time.
        std: noise of each state's measurement, in its unit.
    """
    total = sum(len(recording) * recording.dt for recording in recordings)
    cell = max(MAP_CELL_S, total / MAP_WINDOWS)
    windows = cut(recordings, std, every=cell)
    x0 = fit_initial_states(model, windows, theta)
    r = residuals_at(model, windows, theta, x0)
    squares = np.square(r).reshape(windows.y.shape).sum(axis=2)  # (W, X)
    samples = windows.measured.sum(axis=2)
    longest = max(recording.time[-1] for recording in recordings)
    edges = cell * np.arange(int(np.ceil(longest / cell)) + 1)
    length = windows.y.shape[2] * windows.dt
    covers = (edges[None, 1:] > windows.start_s[:, None]) & (
        edges[None, :-1] < windows.start_s[:, None] + length
    )
    of = windows.recording[:, None] == np.arange(len(recordings))  # (W, R)
    sums, counts = (
        np.einsum("wx,wr,wc->xrc", part, of, covers, optimize=True) for part in (squares, samples)
    )
    misfit = np.sqrt(np.where(counts > 0, sums / np.maximum(counts, 1), np.nan))
    return TimeMap(tuple(recording.name for recording in recordings), edges, misfit)


@dataclass(frozen=True)
class MissingForce:
    """The generalised force that a model leaves over, at N instants of the recordings."""

    q: Float[np.ndarray, "N J"]
    """positions [m or rad]"""
    v: Float[np.ndarray, "N J"]
    """velocities [m/s or rad/s]"""
    u: Float[np.ndarray, "N U"]
    """commands"""
    force: Float[np.ndarray, "N J"]
    """what is missing at each joint [N or N m]"""


def missing_force(
    model: PlantModel,
    theta: Float[np.ndarray, " p"],
    recordings: Sequence[Recording],
    std: Float[np.ndarray, " X"],
) -> MissingForce:
    """M(q) times the acceleration that a model lacks, as a mean over short spans.

    From the smoothed state at its beginning the model is simulated through each span; what the
    velocity is short of at the end, over the span's length, is the acceleration that it lacks.
    Arguments are those of `time_map`.

    Raises:
        InputError: nowhere are positions measured for long enough.
    """
    dt = recordings[0].dt
    steps = max(1, round(FORCE_SPAN_S / dt))
    samples = sum(map(len, recordings))
    spans = cut(recordings, std, (steps + 1) * dt, every=dt * max(1, samples // FORCE_SPANS))
    begin = np.round(spans.start_s / dt).astype(int)
    pairs = tuple((x, x + 1) for x in range(0, len(std), 2))
    known = [smoothed(replace(recording, velocities=pairs))[0] for recording in recordings]
    here, there = (
        np.stack([known[n][k] for n, k in zip(spans.recording, begin + ahead, strict=True)])
        for ahead in (0, steps)
    )
    fine = np.flatnonzero(np.isfinite(here).all(axis=1) & np.isfinite(there).all(axis=1))
    if not len(fine):
        raise InputError("no stretch of the recordings is measured well enough for forces.")
    spans, here, there = spans[fine], here[fine], there[fine]
    end = run(model, spans, theta[None], here[None])[0][:, :, steps]
    lacking = (there - end)[:, 1::2] / (steps * dt)
    q, v = (0.5 * (here + there)[:, part::2] for part in (0, 1))
    force = np.einsum("nij,nj->ni", model.plant.mass_matrix(q), lacking)
    u = spans.driven[:, :steps].mean(axis=1)
    sound = np.isfinite(force).all(axis=1)
    return MissingForce(q[sound], v[sound], u[sound], force[sound])
