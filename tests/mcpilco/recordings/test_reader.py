"""A log becomes a recording on a uniform grid; what is wrong with it is masked and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mcpilco.recordings import read_recordings, write_recording
from mcpilco.typing import InputError, RecordingError
from tests.mcpilco.recordings.logs import (
    INPUTS,
    NAMES,
    STATES,
    log,
    motion,
    read,
    uniform,
    write,
)


def test_a_uniform_log_is_taken_as_it_is(tmp_path: Path) -> None:
    rows = uniform()
    recording = read(write(tmp_path / "swing.csv", rows))
    assert recording.name == "swing"
    assert recording.dt == pytest.approx(0.02)
    np.testing.assert_array_equal(recording.states, rows[:, 1:5])
    np.testing.assert_array_equal(recording.inputs, rows[:, 5:])
    assert recording.gaps == ()
    assert recording.remarks == ()


def test_time_begins_at_zero(tmp_path: Path) -> None:
    rows = uniform()
    rows[:, 0] += 1.7e9  # seconds since 1970
    recording = read(write(tmp_path / "a.csv", rows))
    assert recording.time[0] == 0
    assert recording.dt == pytest.approx(0.02)


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    rows = uniform()
    rows[40:60, 5] = np.nan  # a gap
    rows[100, 1] = np.nan  # a masked value
    rows = np.delete(rows, slice(140, 150), 0)  # a jump
    first = read(write(tmp_path / "a.csv", rows))
    second = read(write_recording(tmp_path / "b.csv", first))
    np.testing.assert_array_equal(first.states, second.states)
    np.testing.assert_array_equal(first.inputs, second.inputs)
    np.testing.assert_allclose(first.gaps, second.gaps)
    written = (tmp_path / "b.csv").read_bytes()
    assert write_recording(tmp_path / "c.csv", second).read_bytes() == written


# columns ------------------------------------------------------------------------------------------


def test_a_column_map_renames(tmp_path: Path) -> None:
    names = ("time_s", "x", "dx", "theta", "dtheta", "u")
    path = write(tmp_path / "a.csv", uniform(), names)
    recording = read(path, columns=dict(zip(NAMES, names, strict=True)))
    np.testing.assert_array_equal(recording.states, uniform()[:, 1:5])


def test_units_in_the_header_are_converted_and_said(tmp_path: Path) -> None:
    rows, plain = uniform(), read(write(tmp_path / "plain.csv", uniform()))
    rows = rows * np.array([1e3, 1.0, 1.0, 180.0 / np.pi, 1.0, 1.0])
    named = ("time [ms]", "cart_position (m)", "cart_velocity", "pole_angle[deg]", *NAMES[4:])
    recording = read(write(tmp_path / "units.csv", rows, named))
    np.testing.assert_allclose(recording.states, plain.states, atol=1e-12)
    assert recording.dt == pytest.approx(plain.dt)
    assert recording.remarks == (
        "'time [ms]' is converted to SI units, as its name says.",
        "'pole_angle[deg]' is converted to SI units, as its name says.",
    )


def test_a_row_of_units_below_the_header_is_read(tmp_path: Path) -> None:
    rows, plain = uniform() * [1, 1, 1, 180.0 / np.pi, 1, 1], uniform()
    path = write(tmp_path / "units.csv", rows, ("t", *NAMES[1:]))
    header, _, rest = path.read_text().partition("\n")
    path.write_text(f"{header}\ns,m,m/s,deg,rad/s,N\n{rest}")
    recording = read(path, columns={"time": "t"})
    np.testing.assert_allclose(recording.states, plain[:, 1:5], atol=1e-12)
    assert recording.remarks == ("'pole_angle [deg]' is converted to SI units, as its name says.",)


def test_a_unit_that_is_asked_for_counts_alone(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", uniform(), (*NAMES[:3], "pole_angle [deg]", *NAMES[4:]))
    half = read(path, columns={"pole_angle": "pole_angle [deg]@0.5"})
    assert not any("as its name says" in remark for remark in half.remarks)
    np.testing.assert_allclose(half.states[:, 2], 0.5 * uniform()[:, 3])


def test_a_unit_that_nobody_knows_is_no_column_of_that_name(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", uniform(), (*NAMES[:3], "pole_angle [counts]", *NAMES[4:]))
    with pytest.raises(RecordingError, match="a column for each of pole_angle, got the columns"):
        read(path)


def test_a_missing_column_is_named_beside_those_that_are_there(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", uniform(), ("time", "x", "dx", "theta", "dtheta", "force"))
    with pytest.raises(RecordingError) as caught:
        read(path)
    assert "a column for each of cart_position, pole_angle" in str(caught.value)
    assert "time, x, dx, theta, dtheta, force" in str(caught.value)
    assert "--columns cart_position=NAME" in str(caught.value)


@pytest.mark.parametrize("name", ["time", "cart_position", "pole_angle", "force"])
def test_time_positions_and_inputs_must_be_there(tmp_path: Path, name: str) -> None:
    place = NAMES.index(name)
    names = NAMES[:place] + NAMES[place + 1 :]
    path = write(tmp_path / "a.csv", np.delete(uniform(), place, 1), names)
    with pytest.raises(RecordingError, match=f"a column for each of {name}, got the columns"):
        read(path)


def test_velocities_may_be_absent(tmp_path: Path) -> None:
    names = tuple(name for name in NAMES if "velocity" not in name)
    path = write(tmp_path / "a.csv", uniform()[:, [0, 1, 3, 5]], names)
    recording = read(path)
    np.testing.assert_array_equal(recording.measured, [True, False, True, False])
    assert np.isnan(recording.states[:, [1, 3]]).all()
    np.testing.assert_array_equal(recording.states[:, 2], uniform()[:, 3])


def test_a_velocity_that_the_map_names_must_be_there(tmp_path: Path) -> None:
    names = tuple(name for name in NAMES if "velocity" not in name)
    path = write(tmp_path / "a.csv", uniform()[:, [0, 1, 3, 5]], names)
    with pytest.raises(RecordingError, match="a column for each of omega"):
        read(path, columns={"pole_velocity": "omega"})


def test_a_map_of_an_unknown_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="got angel; write NAME_OF_THE_PLANT=NAME_IN_THE_FILE"):
        read(write(tmp_path / "a.csv", uniform()), columns={"angel": "theta"})


def test_one_bad_file_loses_no_other(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"{k}.csv", uniform()) for k in range(3)]
    paths[1].write_text("time\n")
    good, bad = read_recordings([*paths, tmp_path / "none.csv"], STATES, INPUTS)
    assert [recording.name for recording in good] == ["0", "2"]
    assert [str(paths[1]) in str(bad[0]), "none.csv" in str(bad[1])] == [True, True]


# time stamps --------------------------------------------------------------------------------------


def error(recording, dt: float) -> np.ndarray:
    """Largest error of each state where it is known."""
    truth = motion(dt * np.arange(len(recording)))[:, :4]
    return np.nanmax(np.abs(recording.states - truth), axis=0) / np.abs(truth).max(0)


def test_jittering_stamps_are_resampled_to_the_true_motion(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    time = 0.02 * np.arange(300) + rng.uniform(-0.006, 0.006, 300)
    time -= time[0]
    recording = read(write(tmp_path / "a.csv", log(time)))
    assert recording.dt == pytest.approx(0.02)
    assert error(recording, 0.02).max() < 1e-3
    assert any("Resampled to a step of 0.02 s" in remark for remark in recording.remarks)


def test_an_input_keeps_its_impulse_when_it_is_resampled(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    time = np.cumsum(rng.uniform(0.01, 0.03, 300))
    time -= time[0]
    rows = log(time)
    rows[:, 5] = rng.uniform(-5, 5, 300)
    recording = read(write(tmp_path / "a.csv", rows), dt=0.02)
    held = np.concatenate([[0.0], np.cumsum(rows[:-1, 5] * np.diff(time))])
    impulse = np.cumsum(recording.inputs[:-1, 0]) * 0.02
    np.testing.assert_allclose(impulse, np.interp(recording.time[1:], time, held), atol=1e-9)


def test_a_fast_log_is_decimated_with_less_noise(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rows = uniform(5000, 0.002)
    rows[:, 1] += 1e-3 * rng.standard_normal(5000)
    recording = read(write(tmp_path / "a.csv", rows), dt=0.02)
    assert len(recording) == 500
    truth = motion(recording.time)[:, 0]
    assert np.std(recording.states[:, 0] - truth) < 0.6e-3
    assert error(recording, 0.02)[2] < 2e-3


@pytest.mark.parametrize(
    ("stamps", "dt"),
    [
        (np.round(np.arange(400) / 300, 6), 1 / 300),
        (np.round(0.01 * np.arange(400), 2), 0.01),
        (0.0125 * np.arange(400), 0.0125),
    ],
)
def test_the_step_is_that_of_the_stamps(tmp_path: Path, stamps: np.ndarray, dt: float) -> None:
    recording = read(write(tmp_path / "a.csv", log(stamps)))
    assert recording.dt == pytest.approx(dt, rel=1e-6)
    assert recording.remarks == ()


def test_a_jump_of_the_stamps_is_a_gap(tmp_path: Path) -> None:
    rows = np.delete(uniform(), slice(50, 60), 0)  # rows at 1.00 to 1.18 s are missing
    recording = read(write(tmp_path / "a.csv", rows))
    np.testing.assert_allclose(recording.gaps, [(0.98, 1.2)])
    assert np.isnan(recording.states[50:60]).all()
    assert np.isfinite(recording.states[[49, 60]]).all()
    assert [(s.start, s.stop) for s in recording.segments()] == [(0, 50), (60, 200)]
    assert any("gap from 0.980 to 1.200 s" in remark for remark in recording.remarks)


def test_a_jump_between_jittering_stamps_is_a_gap_too(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    time = 0.02 * np.arange(300) + rng.uniform(-0.005, 0.005, 300)
    time[150:] += 0.5
    time -= time[0]
    recording = read(write(tmp_path / "a.csv", log(time)))
    ((start, end),) = recording.gaps
    assert start <= time[149] < start + 0.02
    assert end - 0.02 < time[150] <= end
    assert error(recording, 0.02).max() < 5e-3  # beside the gap interpolation is linear


def test_repeated_and_backward_stamps_are_left_out_and_said(tmp_path: Path) -> None:
    rows = uniform()
    order = [*range(100), 99, *range(100, 150), 120, *range(150, 200)]
    recording = read(write(tmp_path / "a.csv", rows[order]))
    np.testing.assert_array_equal(recording.states, rows[:, 1:5])
    assert any("2 rows left out, whose time stamps repeat" in r for r in recording.remarks)


def test_one_wild_stamp_costs_one_row(tmp_path: Path) -> None:
    rows = uniform()
    rows[70, 0] = 1e6
    recording = read(write(tmp_path / "a.csv", rows))
    assert np.isnan(recording.states[70]).all()
    assert np.isfinite(np.delete(recording.states, 70, 0)).all()


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (np.tile(0.02 * np.arange(100), 2), "column 'time': expected time to increase"),
        (0.02 * np.arange(200)[::-1], "column 'time': expected time to increase"),
        (np.zeros(200), "column 'time': expected time to increase"),
        (
            20.0 * np.arange(200),
            "expected seconds, got a median step of 20, which looks like milli",
        ),
        (np.append(-1e19, 0.02 * np.arange(199)), "row 2, column 'time': expected a stamp near"),
        (np.append(-1e6, 0.02 * np.arange(199)), "row 3: expected time stamps about 0.02 s apart"),
        (np.append(0.02 * np.arange(199), 1e9), "row 201: expected time stamps about 0.02 s apart"),
    ],
)
def test_time_beyond_repair_is_refused(tmp_path: Path, stamps: np.ndarray, said: str) -> None:
    rows = uniform()
    rows[:, 0] = stamps
    with pytest.raises(RecordingError, match=said):
        read(write(tmp_path / "a.csv", rows))


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf, 0.001])
def test_a_step_that_cannot_be_meant_is_refused(tmp_path: Path, dt: float) -> None:
    with pytest.raises(InputError, match="dt must be"):
        read(write(tmp_path / "a.csv", uniform()), dt=dt)


@pytest.mark.parametrize("rows", [0, 1, 9])
def test_a_few_rows_are_no_recording(tmp_path: Path, rows: int) -> None:
    with pytest.raises(RecordingError, match=f"at least 10 rows .* got {rows}; record for longer"):
        read(write(tmp_path / "a.csv", uniform(rows)))


# values -------------------------------------------------------------------------------------------


def test_a_missing_value_is_masked_alone(tmp_path: Path) -> None:
    rows = uniform()
    rows[30, 3] = np.nan
    recording = read(write(tmp_path / "a.csv", rows))
    np.testing.assert_array_equal(recording.states, rows[:, 1:5])
    assert recording.gaps == ()
    assert "1 value of pole_angle missing, masked." in recording.remarks


def test_a_long_loss_of_a_position_is_a_gap(tmp_path: Path) -> None:
    rows = uniform()
    rows[30:40, 3] = np.nan
    recording = read(write(tmp_path / "a.csv", rows))
    np.testing.assert_allclose(recording.gaps, [(0.58, 0.80)])


def test_where_the_input_is_unknown_nothing_may_be_simulated(tmp_path: Path) -> None:
    rows = uniform()
    rows[30:33, 5] = np.nan
    recording = read(write(tmp_path / "a.csv", rows))
    np.testing.assert_allclose(recording.gaps, [(0.60, 0.66)])
    assert np.isfinite(recording.inputs).all()
    np.testing.assert_array_equal(recording.inputs[30:33, 0], rows[29, 5])


def test_a_column_without_values_is_refused(tmp_path: Path) -> None:
    for place, said in (
        (5, "commands in the column of 'force'"),
        (1, "samples of 'cart_position'"),
    ):
        rows = uniform()
        rows[:, place] = np.nan
        with pytest.raises(RecordingError, match=said):
            read(write(tmp_path / "a.csv", rows))


@pytest.mark.parametrize("length", [1, 2, 3])
def test_spikes_are_masked_and_nothing_else(tmp_path: Path, length: int) -> None:
    rng = np.random.default_rng(0)
    rows = uniform(500)
    rows[:, 1:5] += [1e-3, 1e-2, 2e-3, 2e-2] * rng.standard_normal((500, 4))
    rows[77 : 77 + length, 1] += 0.2
    rows[300 : 300 + length, 3] -= 40.0
    recording = read(write(tmp_path / "a.csv", rows))
    masked = {(int(k), int(j)) for k, j in np.argwhere(np.isnan(recording.states))}
    expected = {(77 + k, 0) for k in range(length)} | {(300 + k, 2) for k in range(length)}
    assert masked == expected
    assert any("cart_position far off" in r and "at 1.540 s" in r for r in recording.remarks)


@pytest.mark.parametrize("hold", [3, 25])
def test_bang_bang_motion_has_no_spikes(tmp_path: Path, hold: int) -> None:
    """The velocity is a saw tooth, the position has kinks in its second derivative."""
    acceleration = np.where(np.arange(500) // hold % 2, 30.0, -30.0)
    velocity = np.cumsum(acceleration) * 0.02
    rows = uniform(500)
    rows[:, 2], rows[:, 1] = velocity, np.cumsum(velocity) * 0.02
    recording = read(write(tmp_path / "a.csv", rows))
    assert np.isfinite(recording.states).all()


@pytest.mark.parametrize("width", [0.05, 0.055])
def test_the_top_of_a_narrow_wave_is_no_spike(tmp_path: Path, width: float) -> None:
    """As the velocity of a pole that turns fast, each time it passes the bottom."""
    rows = uniform(500)
    rows[:, 2] = -10.0 - 8.0 * np.exp(-((((rows[:, 0] + 0.2) % 0.4 - 0.2) / width) ** 2))
    rows[rows[:, 0] < 5.0, 2] = -10.0
    assert np.isfinite(read(write(tmp_path / "a.csv", rows)).states).all()


def test_a_wrapped_angle_counts_its_turns(tmp_path: Path) -> None:
    rows = uniform(500)
    turning = 3.0 * rows[:, 0] + np.sin(rows[:, 0])
    rows[:, 3] = (turning + np.pi) % (2 * np.pi) - np.pi
    recording = read(write(tmp_path / "a.csv", rows))
    np.testing.assert_allclose(recording.states[:, 2], turning, atol=1e-9)
    assert any("turns are counted" in remark for remark in recording.remarks)


def test_no_other_state_is_unwrapped(tmp_path: Path) -> None:
    rows = uniform(500)
    rows[:, 1] = 6.0 * (rows[:, 0] > 5) - 3
    recording = read(write(tmp_path / "a.csv", rows))
    np.testing.assert_array_equal(recording.states[:, 0], rows[:, 1])


# suspicions ---------------------------------------------------------------------------------------


def said(tmp_path: Path, rows: np.ndarray) -> str:
    return " ".join(read(write(tmp_path / "a.csv", rows)).remarks)


def test_foreign_units_are_noticed(tmp_path: Path) -> None:
    degrees = uniform(500)
    degrees[:, 3] *= 180 / np.pi
    assert "pole_velocity is 0.0174 times the derivative of pole_angle" in said(tmp_path, degrees)
    assert "pole_angle spans 172 rad; is it in degrees?" in said(tmp_path, degrees)
    backwards = uniform(500)
    backwards[:, 2] *= -1
    assert "cart_velocity is -0.999 times the derivative" in said(tmp_path, backwards)


def test_a_coarse_encoder_is_noticed(tmp_path: Path) -> None:
    rows = uniform(500)
    rows[:, 3] = 0.05 * np.round(rows[:, 3] / 0.05)
    recording = read(write(tmp_path / "a.csv", rows))
    assert recording.resolution[2] == pytest.approx(0.05)
    assert recording.resolution[0] == 0
    assert any("pole_angle comes in steps of 0.05" in r for r in recording.remarks)


def test_a_stuck_channel_and_a_dead_input_are_noticed(tmp_path: Path) -> None:
    rows = uniform(500)
    rows[:, 5] = -0.0
    rows[100:200, 3] = rows[100, 3]
    remarks = said(tmp_path, rows)
    assert "pole_angle is" in remarks
    assert "to the last digit from 2.000 to 3.980 s; is it stuck?" in remarks
    assert "force is 0 throughout; it excites nothing." in remarks


def test_a_command_that_stands_out_is_noticed_and_kept(tmp_path: Path) -> None:
    rows = uniform(500)
    rows[:, 5] *= 0.4  # up to 2 N
    assert "force" not in said(tmp_path, rows)
    rows[77:79, 5] = -17.0
    remark = "force is -17 at most, from 1.540 s on, and within 2 in 99 % of the samples"
    assert remark in said(tmp_path, rows)
    np.testing.assert_array_equal(read(write(tmp_path / "a.csv", rows)).inputs[:, 0], rows[:, 5])
