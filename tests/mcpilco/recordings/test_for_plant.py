"""Recordings of a plant: a column map a file, columns that are ignored, a line a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import envs
from mcpilco.recordings import read_for_plant
from mcpilco.typing import InputError
from tests.mcpilco.recordings.logs import uniform, write

PLANT = envs.PLANTS["mcpilco/CartPoleSwingUp-v0"]()


def test_files_with_other_headers_have_a_map_each(tmp_path: Path) -> None:
    rest = ("cart_velocity", "pole_angle", "pole_velocity", "force")
    paths = [
        write(tmp_path / "old.csv", uniform(), ("t", "x", *rest)),
        write(tmp_path / "new_1.csv", uniform(), ("stamp", "cart_position", *rest)),
        write(tmp_path / "new_2.csv", uniform(), ("stamp", "cart_position", *rest)),
    ]
    maps = {
        "*": {"pole_velocity": ""},
        "old.csv": {"time": "t", "cart_position": "x"},
        "new_*": {"time": "stamp"},
    }
    recordings, _ = read_for_plant(PLANT, paths, maps)
    for recording in recordings:
        np.testing.assert_array_equal(recording.states[:, :3], uniform()[:, 1:4])
        assert recording.measured.tolist() == [True, True, True, False]
    with pytest.raises(InputError, match=r"expected one of old.csv, new_1.csv, .*, got odd; name"):
        read_for_plant(PLANT, paths, {"odd": {"time": "t"}})


def test_what_no_recording_can_do_without_is_not_ignored(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", uniform())
    with pytest.raises(InputError, match="names of force, pole_angle, .* only velocities can be"):
        read_for_plant(PLANT, [path], {"*": {"pole_angle": "", "force": ""}})


def test_each_recording_has_one_line(tmp_path: Path) -> None:
    rows = uniform(500)
    rows[77, 1] += 5.0
    rows[300, 3] = np.nan
    paths = [write(tmp_path / f"{name}.csv", rows) for name in "ab"]
    _, notes = read_for_plant(PLANT, paths)
    assert [note.split(":")[0] for note in notes] == ["a", "b"]
    assert "far off" in notes[0]
    assert "missing" in notes[0]


def test_nothing_is_compared_while_an_event_lasts(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"{name}.csv", uniform()) for name in ("free", "hit")]
    (free, hit), notes = read_for_plant(PLANT, paths, events={"hit": ((0.13, 0.21),), "free": ()})
    assert free.gaps == ()
    assert notes == ["hit: 1 events are masked."]
    ((start, end),) = hit.gaps
    assert start <= 0.13 < 0.21 <= end < 0.21 + 2 * hit.dt
    inside = (hit.time > start + 1e-9) & (hit.time < end - 1e-9)
    assert np.isnan(hit.states[inside]).all()
    np.testing.assert_array_equal(hit.states[~inside], free.states[~inside])
    first, second = hit.segments()
    assert hit.time[first][-1] == pytest.approx(start)
    assert hit.time[second][0] == pytest.approx(end)
    with pytest.raises(InputError, match="events are of other, expected some of free, hit"):
        read_for_plant(PLANT, paths, events={"other": ((0.0, 0.1),)})
