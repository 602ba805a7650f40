"""What stamps that jitter are taken for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.mcpilco.recordings.logs import log, read, write

DT = 0.02


def jitter(rows: int) -> np.ndarray:
    return np.append(0.0, np.random.default_rng(0).uniform(-2e-3, 2e-3, rows - 1))


def noisy(rows: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(1).standard_normal((len(rows), 4)) * [1e-3, 1e-2, 2e-3, 2e-2]
    return rows + np.pad(noise, ((0, 0), (1, 1)))


def test_samples_that_jitter_are_put_where_their_stamps_say(tmp_path: Path) -> None:
    time = DT * np.arange(300) + jitter(300)
    recording = read(write(tmp_path / "a.csv", noisy(log(time))))
    assert np.abs(recording.states - log(recording.time)[:, 1:5])[:, 0].max() < 6e-3
    assert recording.by_clock is not None


def test_stamps_that_jitter_alone_move_no_sample(tmp_path: Path) -> None:
    rows = noisy(log(DT * np.arange(300)))
    recording = read(write(tmp_path / "a.csv", rows + jitter(300)[:, None] * np.eye(6)[0]))
    np.testing.assert_array_equal(recording.states, rows[:, 1:5])
    np.testing.assert_array_equal(recording.inputs, rows[:, 5:])
    assert recording.by_clock is None


def test_commands_by_a_clock_are_told_beside_those_by_the_stamps(tmp_path: Path) -> None:
    time = DT * np.arange(300)
    rows = log(time + jitter(300))
    rows[:, 5] = np.repeat(np.random.default_rng(2).uniform(-5, 5, 30), 10)
    recording = read(write(tmp_path / "a.csv", rows))
    assert recording.by_clock is not None
    assert np.abs(recording.by_clock - rows[:, 5:])[1:].max() < 0.2
    assert np.abs(recording.inputs - rows[:, 5:]).max() > 0.5
