from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mcpilco.gap import Gap, summary
from mcpilco.show import side_by_side as film
from mcpilco.show.report import write_gap_report
from mcpilco.show.report.gap_page import cautions
from mcpilco.show.side_by_side import Clip, write_gap_film
from mcpilco.typing import InputError
from tests.mcpilco.show.test_recording import chunks, rrd


def test_film_holds_measured_nominal_and_corrected_and_rerun_verifies_it(
    found: Gap, tmp_path: Path
) -> None:
    path = write_gap_film(found, tmp_path / "gap.rrd")
    assert rrd("verify", path) == 0
    held = set(chunks(path))
    for name in ("measured", "nominal", "corrected"):
        assert {f"states/angle/{name}", f"world/{name}/bodies/pendulum"} <= held


def test_clips_do_not_overlap_and_the_first_is_missed_most(
    found: Gap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[Clip] = []
    monkeypatch.setattr(film, "write_side_by_side", lambda path, clips, *rest: shown.extend(clips))
    write_gap_film(found, tmp_path / "gap.rrd")
    ends = [np.sqrt(np.nanmean(np.square(c.measured - c.models["nominal"])[-5:])) for c in shown]
    assert ends == sorted(ends, reverse=True)
    assert {clip.note.split(",")[0] for clip in shown} == {f"### {n}" for n in found.held_out}
    assert found.comparison is not None
    windows = found.comparison.windows
    samples = sum(len(r) for r in found.recordings if r.name in found.held_out)
    assert 2 < len(shown) <= samples // 2 // windows.y.shape[2]  # the other half decides


def test_states_and_commands_are_shown_with_their_units(
    found: Gap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[film.Naming] = []
    monkeypatch.setattr(film, "write_side_by_side", lambda *given: told.append(given[3]))
    write_gap_film(found, tmp_path / "gap.rrd")
    assert told[0].states == {"angle": "rad", "velocity": "rad/s"}
    assert told[0].inputs == {"torque": "N m"}


@pytest.mark.slow
def test_a_free_run_that_runs_away_is_shown_as_far_as_it_goes_and_told(
    found: Gap, tmp_path: Path
) -> None:
    assert found.comparison is not None
    runs = {name: y.copy() for name, y in found.comparison.runs.items()}
    runs["corrected"][:, :, 20:] = np.nan  # at once in all, so that each clip has it
    runs["nominal"][3, :, 35:] = np.inf
    lost = replace(found, comparison=replace(found.comparison, runs=runs))
    assert rrd("verify", write_gap_film(lost, tmp_path / "gap.rrd")) == 0
    windows = len(found.comparison.windows)
    said = f"The corrected plant runs away in {windows} of {windows} windows, first 0.4 s after"
    for told in (cautions(lost), summary(lost)):
        assert any(line.startswith(said) for line in told)
    page = write_gap_report(lost, tmp_path / "report.html").read_text()
    assert said in page
    assert "Traceback" not in page


def test_recordings_that_are_too_poor_make_no_film(found: Gap, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="too poor"):
        write_gap_film(replace(found, comparison=None), tmp_path / "gap.rrd")
