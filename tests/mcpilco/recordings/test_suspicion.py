"""Masked samples were read wrongly, however fast a machine moves."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mcpilco.recordings import Recording, read_recording
from tests.mcpilco.recordings.faultless import SAMPLES, Faultless, recordings

QUANSER = ("cart_position", "cart_velocity", "pole_angle", "pole_velocity")


@cache
def faultless() -> tuple[Faultless, ...]:
    return tuple(recordings())


def read(path: Path, one: Faultless, states: np.ndarray) -> Recording:
    """What the reader makes of an .npz of such states."""
    names = tuple(f"{kind}{j}" for j in range(states.shape[1] // 2) for kind in "qv")
    columns = dict(zip(names, states.T, strict=True))
    time = one.dt * np.arange(SAMPLES)
    np.savez(path, time=time, u=np.sin(time), **columns)
    velocities = tuple((k, k + 1) for k in range(0, len(names), 2))
    return read_recording(path, names, ("u",), velocities=velocities)


def test_no_sample_of_forty_faultless_recordings_is_masked(tmp_path: Path) -> None:
    masked = {
        one.name: int(np.isnan(read(tmp_path / "a.npz", one, one.states).states).sum())
        for one in faultless()
    }
    assert len(masked) == 40
    assert not any(masked.values()), {name: n for name, n in masked.items() if n}


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    "fault",
    ["wrong", "turned", *(pytest.param(x, marks=pytest.mark.slow) for x in ("zero", "row"))],
)
def test_wrong_readings_in_them_are_masked_and_nothing_beside(tmp_path: Path, fault: str) -> None:
    """Of a column, or of all at once; of a velocity that comes with coarse samples not all."""
    rng = np.random.default_rng(0)
    found, all_in, beside = np.zeros(2), np.zeros(2), 0
    for one in faultless():
        states = one.states.copy()
        for start in rng.choice(np.arange(20, SAMPLES - 20, 40), 3, replace=False):
            these = slice(start, start + int(rng.integers(1, 4)))
            columns = slice(None) if fault == "row" else int(rng.integers(states.shape[1]))
            states[these, columns] = {
                "wrong": states[these, columns] + 1.5 * np.ptp(one.states, axis=0)[columns],
                "turned": states[these, columns] - 2.0 * np.pi,
                "zero": 0.0,
                "row": 2.0 * one.states.max(axis=0) + 1.0,
            }[fault]
        off = np.abs(states - one.states)
        high = off > 0.5 * np.ptp(one.states, axis=0)  # less may be motion
        masked = np.isnan(read(tmp_path / "a.npz", one, states).states)
        beside += int((masked & (off == 0.0)).sum())
        for part in range(2):
            found[part] += (masked & high)[:, part::2].sum()
            all_in[part] += high[:, part::2].sum()
    assert beside == 0
    assert found[0] > 0.97 * all_in[0]
    assert found[1] > 0.7 * all_in[1]


def test_no_velocity_of_a_real_swing_up_is_masked(data: Path) -> None:
    """They come from a filter that each count of an encoder makes jump."""
    for path in sorted((data / "quanser_cart_pole").glob("*.csv")):
        pairs = ((0, 1), (2, 3))
        recording = read_recording(path, QUANSER, ("voltage",), angles=(2,), velocities=pairs)
        assert np.isfinite(recording.states).all(), path.name


def test_a_fast_swing_at_few_samples_is_told_by_the_other_column(tmp_path: Path) -> None:
    """An elbow that whips round within a sample, and a velocity that was read so wrongly."""
    time = 0.05 * np.arange(SAMPLES)
    swing = (time - 12.5) / 0.018
    true = np.column_stack([0.018 * 30.0 * np.arctan(swing), 30.0 / (1.0 + swing**2)])
    true += [1e-4, 1e-3] * np.random.default_rng(0).standard_normal(true.shape)
    one = Faultless("elbow", 0.05, true)
    assert np.isfinite(read(tmp_path / "a.npz", one, true).states).all()
    wrong = true.copy()
    wrong[:, 0] = 1e-4 * np.random.default_rng(1).standard_normal(SAMPLES)
    masked = np.argwhere(np.isnan(read(tmp_path / "a.npz", one, wrong).states))
    assert [250, 1] in masked.tolist()
    assert set(masked[:, 1]) == {1}
