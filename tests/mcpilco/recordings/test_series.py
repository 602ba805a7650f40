"""Laws of what goes into a Volterra series: bad data get a sentence that says what to record."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.recordings import Series, lagged, read_series, suspicions, usable
from mcpilco.typing import InputError, RecordingError


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape)


def test_regressors_hold_the_newest_first_and_channel_by_channel() -> None:
    inputs = np.stack([np.arange(5.0), 10.0 + np.arange(5.0)], 1)
    X = lagged(inputs, 2)
    assert X.shape == (3, 6)
    assert X[0].tolist() == [2.0, 1.0, 0.0, 12.0, 11.0, 10.0]


def test_a_missing_value_costs_the_samples_that_need_it() -> None:
    u, y = noise(50), noise(50, seed=1)
    u[10], y[30] = np.nan, np.nan
    X, Y = usable(Series.of(u, y), lags=3)
    assert len(X) == len(Y) == 47 - 4 - 1
    assert np.isfinite(X).all()
    assert np.isfinite(Y).all()


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(
        InputError, match="Of 7 rows 4 have an output and all 3 lags .* 20 are needed"
    ):
        usable(Series.of(noise(7), noise(7)), lags=3)
    with pytest.raises(InputError, match="Record for longer"):
        usable(Series.of(noise(3), noise(3)), lags=5)


def test_what_stands_still_is_refused() -> None:
    with pytest.raises(InputError, match="input 'u' stands still at 2; record it while"):
        usable(Series.of(np.full(50, 2.0), noise(50)), lags=3)
    with pytest.raises(InputError, match="output 'y' stands still at 0; check its sensor"):
        usable(Series.of(noise(50), np.zeros(50)), lags=3)


def test_a_log_that_repeats_its_rows_is_refused() -> None:
    u, y = np.repeat(noise(30), 2), np.repeat(noise(30, seed=1), 2)
    with pytest.raises(InputError, match="repeat the row before: the log is faster than"):
        usable(Series.of(u, y), lags=3)


def told(u: np.ndarray, degree: int = 2) -> tuple[tuple[str, ...], tuple[str, ...]]:
    return suspicions(Series.of(u, noise(len(u))), lags=4, degree=degree, center=False)


def test_white_noise_identifies_everything() -> None:
    assert told(noise(200)) == ((), ())


def test_powers_of_a_binary_input_cannot_be_told() -> None:
    unidentified, warnings = told(np.sign(noise(200)))
    assert unidentified == ("powers of u from 2 on",)
    assert "record it with more than 2 levels" in warnings[0]


def test_lags_of_a_sine_cannot_be_told() -> None:
    unidentified, warnings = told(np.sin(0.3 * np.arange(200)))
    assert unidentified == ("lags of u",)
    assert "The 5 lags of u move in 2 directions only" in warnings[0]


def test_a_few_repeated_rows_are_told() -> None:
    u, y = noise(100), noise(100, seed=1)
    u[50:53], y[50:53] = u[49], y[49]
    _, warnings = suspicions(Series.of(u, y), lags=4, degree=2, center=False)
    assert warnings == ("3% of the rows repeat the row before; are they measured?",)


def test_arrays_of_different_length_are_refused() -> None:
    with pytest.raises(InputError, match="at the same times"):
        Series.of(noise(5), noise(6))


# Files --------------------------------------------------------------------------------------------


def write(path, time, *columns: np.ndarray) -> str:
    rows = zip(time, *columns, strict=True)
    lines = ["time,valve,flow", *(",".join(f"{cell:.6g}" for cell in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def test_columns_are_read_by_name(tmp_path) -> None:
    u, y = noise(20), noise(20, seed=1)
    series = read_series(write(tmp_path / "a.csv", 0.1 * np.arange(20), u, y), ["valve"], ["flow"])
    np.testing.assert_allclose(series.inputs[:, 0], u, rtol=1e-5)
    assert (series.input_names, series.output_names) == (("valve",), ("flow",))


def test_a_column_that_is_not_there_is_named(tmp_path) -> None:
    path = write(tmp_path / "a.csv", np.arange(15), noise(15), noise(15))
    with pytest.raises(RecordingError, match="each of u, got the columns time, valve, flow"):
        read_series(path, ["u"], ["flow"])


def test_uneven_steps_are_refused(tmp_path) -> None:
    time = 0.1 * np.arange(20)
    time[12:] += 0.3
    path = write(tmp_path / "a.csv", time, noise(20), noise(20))
    with pytest.raises(RecordingError, match="row 14: expected a step of 0.1 s .* got 0.4 s"):
        read_series(path, ["valve"], ["flow"])
