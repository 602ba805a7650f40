"""Recordings as windows, and windows in parts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mcpilco.gap.data import GapProblem, Windows, apart, cut, split
from mcpilco.gap.fit import Fit, misfits
from mcpilco.gap.sensitivities import run
from tests.mcpilco.gap.test_sensitivities import hopping
from tests.mcpilco.mjcf.mujoco.models import HOPPER


def test_the_parts_of_a_window_are_driven_and_measured_as_it_is(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    """Simulated from the states on the way, they go where the whole window goes."""
    _, windows, null = lagging
    parts = split(windows, 4)
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
    parts = split(windows, 3)
    first = np.nanargmax(np.isfinite(parts.y[:, 0]), axis=1)
    seen = parts.y[np.arange(len(parts)), 0, first]
    near = seen - parts.guess[:, 1] * parts.dt * first
    assert np.median(np.abs(parts.guess[:, 0] - near)) < 0.02 * np.ptp(seen)


def _samples(windows: Windows) -> set[tuple[int, int]]:
    """Recording and number of each sample that some windows hold."""
    first = np.round(windows.start_s / windows.dt).astype(int)
    T = windows.y.shape[2]
    return {
        (int(n), k) for n, f in zip(windows.recording, first, strict=True) for k in range(f, f + T)
    }


@given(counts=st.lists(st.integers(1, 40), min_size=1, max_size=4), stride=st.integers(3, 20))
def test_windows_that_decide_and_those_of_which_errors_are_told_share_no_sample(
    counts: list[int], stride: int
) -> None:
    """Unless they are few: then all do both."""
    W, T, dt = sum(counts), 20, 0.05
    windows = Windows(
        y=np.zeros((W, 2, T)),
        commands=np.zeros((W, T, 1)),
        path=np.zeros((W, T, 2)),
        lead=0,
        dt=dt,
        std=np.ones(2),
        guess=np.zeros((W, 2)),
        recording=np.repeat(np.arange(len(counts)), counts),
        start_s=np.concatenate([dt * stride * np.arange(n) for n in counts]),
    )
    decisive, reported = apart(windows)
    if reported is windows:
        assert decisive is windows
        assert W < 40
        return
    assert not _samples(decisive) & _samples(reported)
    assert min(len(decisive), len(reported)) >= 6


def test_recordings_are_parted_whole_where_each_part_has_enough_of_them(
    lagging: tuple[GapProblem, Windows, Fit],
) -> None:
    _, windows, _ = lagging
    decisive, reported = apart(windows)
    assert len(set(windows.recording)) > 1
    assert not set(decisive.recording) & set(reported.recording)
    assert len(decisive) + len(reported) == len(windows)


@pytest.mark.slow
def test_windows_of_a_machine_that_hits_the_ground_begin_at_their_readings() -> None:
    """Through an impact no cubic goes; from the readings the plant stays near."""
    problem = hopping(HOPPER, HOPPER)
    windows = problem.windows()
    smoothed = cut(problem.recordings, problem.std, problem.window_s)
    model = problem.model(windows)
    near, far = (
        misfits(model, windows.part(0, 15), np.zeros(model.nuisances), each.guess)
        for each in (windows, smoothed)
    )
    assert np.median(near) < 0.3 * np.median(far)
