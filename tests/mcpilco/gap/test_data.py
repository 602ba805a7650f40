"""Recordings as windows, and windows in parts."""

from __future__ import annotations

import numpy as np

from mcpilco.gap.data import GapProblem, Windows
from mcpilco.gap.fit import Fit
from mcpilco.gap.sensitivities import run


def test_the_parts_of_a_window_are_driven_and_measured_as_it_is(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    """Simulated from the states on the way, they go where the whole window goes."""
    _, windows, null = lagging
    parts = windows.split(4)
    T = windows.y.shape[2] // 4
    assert len(parts) == 4 * len(windows)
    assert parts.y.shape[2] == T
    whole = run(null.model, windows, null.theta[None], null.x0[None])[0]
    for w in (0, len(windows) - 1):
        own = parts.recording == windows.recording[w]
        first = windows.start_s[w] + windows.dt * T * np.arange(4)
        chosen = [np.flatnonzero(own & np.isclose(parts.start_s, s))[0] for s in first]
        begun = np.stack([whole[w, :, n * T] for n in range(4)])
        some = run(null.model, parts[np.array(chosen)], null.theta[None], begun[None])[0]
        np.testing.assert_allclose(np.concatenate(some, axis=1), whole[w, :, : 4 * T], atol=1e-5)
        known = np.isfinite(parts.y[chosen])
        measured = np.stack(np.split(windows.y[w, :, : 4 * T], 4, axis=1))
        np.testing.assert_array_equal(parts.y[chosen][known], measured[known])


def test_the_start_of_each_part_is_estimated_from_it(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    _, windows, _ = lagging
    parts = windows.split(3)
    first = np.nanargmax(np.isfinite(parts.y[:, 0]), axis=1)
    seen = parts.y[np.arange(len(parts)), 0, first]
    near = seen - parts.guess[:, 1] * parts.dt * first
    assert np.median(np.abs(parts.guess[:, 0] - near)) < 0.02 * np.ptp(seen)
