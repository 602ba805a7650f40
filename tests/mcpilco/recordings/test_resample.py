"""What stamps that jitter are taken for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

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


def lossy(commands: np.ndarray, lost: list[int], jittering: bool) -> np.ndarray:
    """A log of these commands at 50 Hz without some rows."""
    rows = log(DT * np.arange(len(commands)))
    rows[:, 5] = commands
    rows[:, 0] += jitter(len(rows)) if jittering else 0.0
    return np.delete(rows, lost, axis=0)


@pytest.mark.parametrize("jittering", [False, True])
def test_a_lost_row_leaves_the_clock_and_smooth_commands_as_they_are(tmp_path: Path, jittering):
    commands, lost = np.sin(2.0 * np.pi * 1.5 * DT * np.arange(300)), [40, 98, 170, 231]
    recording = read(write(tmp_path / "a.csv", lossy(commands, lost, jittering)))
    assert recording.dt == DT
    assert recording.gaps == ()
    assert np.flatnonzero(np.isnan(recording.states).all(axis=1)).tolist() == lost
    assert np.isfinite(np.delete(recording.states, lost, axis=0)).all()
    np.testing.assert_allclose(recording.clocked.inputs[:, 0], commands, atol=2e-3)
    assert any(remark.startswith("4 rows are missing") for remark in recording.remarks)


@pytest.mark.parametrize("jittering", [False, True])
def test_where_a_lost_row_may_have_jumped_nothing_may_be_simulated(tmp_path: Path, jittering):
    commands = np.repeat(np.random.default_rng(2).uniform(-5, 5, 30), 10)
    lost = [49, 95, 150]  # the last of its command, in the midst of one, the first
    recording = read(write(tmp_path / "a.csv", lossy(commands, lost, jittering)))
    inside = np.zeros(300, dtype=bool)
    for start, end in recording.gaps:
        inside[round(start / DT) : round(end / DT)] = True
    assert inside[[49, 150]].all()
    assert not inside[90:100].any()
    assert inside.sum() <= 6
    np.testing.assert_allclose(recording.clocked.inputs[~inside, 0], commands[~inside], atol=1e-9)


def test_a_value_that_is_missing_among_stamps_that_jitter_is_not_made_up(tmp_path: Path):
    time = DT * np.arange(300) + jitter(300)
    rows = noisy(log(time))
    rows[120, 1] = np.nan
    recording = read(write(tmp_path / "a.csv", rows))
    assert recording.by_clock is not None
    assert np.argwhere(np.isnan(recording.states)).tolist() == [[120, 0]]


def test_long_steps_of_a_log_without_a_clock_are_no_lost_rows(tmp_path: Path):
    steps = np.random.default_rng(4).uniform(0.5, 2.4, 300) * DT
    recording = read(write(tmp_path / "a.csv", log(np.append(0.0, np.cumsum(steps)))))
    assert not any("missing, by the clock" in remark for remark in recording.remarks)


def test_commands_by_a_clock_are_told_beside_those_by_the_stamps(tmp_path: Path) -> None:
    time = DT * np.arange(300)
    rows = log(time + jitter(300))
    rows[:, 5] = np.repeat(np.random.default_rng(2).uniform(-5, 5, 30), 10)
    recording = read(write(tmp_path / "a.csv", rows))
    assert recording.by_clock is not None
    assert np.abs(recording.by_clock - rows[:, 5:])[1:].max() < 0.2
    assert np.abs(recording.inputs - rows[:, 5:]).max() > 0.5


def fast_log(held: int) -> np.ndarray:
    """2 s at 1 kHz, a command a `held` rows."""
    rows = log(1e-3 * np.arange(2000))
    rows[:, 5] = np.repeat(np.random.default_rng(3).uniform(-5, 5, 2000 // held), held)
    return rows


def test_a_thinned_recording_keeps_every_command(tmp_path: Path) -> None:
    rows = fast_log(held=1)
    recording = read(write(tmp_path / "a.csv", rows), dt=DT)
    assert recording.held is not None
    np.testing.assert_allclose(recording.held[: len(rows)], rows[:, 5:])
    np.testing.assert_allclose(recording.inputs[:99, 0], rows[:1980, 5].reshape(99, 20).mean(1))


def test_commands_that_hold_as_long_as_a_sample_are_kept_once(tmp_path: Path) -> None:
    rows = fast_log(held=20)
    recording = read(write(tmp_path / "a.csv", rows), dt=DT)
    assert recording.held is None
    np.testing.assert_allclose(recording.inputs[:, 0], rows[::20, 5])


def test_commands_are_averaged_to_any_rate(tmp_path: Path) -> None:
    recording = read(write(tmp_path / "a.csv", fast_log(held=1)), dt=DT)
    assert recording.held is not None
    coarse = recording.driven(4)
    np.testing.assert_allclose(coarse[:, 0], recording.held.reshape(-1, 5).mean(axis=1))
    np.testing.assert_allclose(coarse.reshape(-1, 4).mean(axis=1), recording.inputs[:, 0])
