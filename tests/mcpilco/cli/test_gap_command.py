"""`mcpilco gap`: what it keeps, shows and refuses; what it finds is tested in the room."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mcpilco.gap
import mcpilco.show
import mcpilco.show.report
from mcpilco.cli import main
from mcpilco.gap import Gap, Stability
from mcpilco.gap.stability import Named, Repetition
from mcpilco.recordings import write_recording
from mcpilco.typing import RunFolderError
from tests.mcpilco.gap.machines import recorded
from tests.mcpilco.mjcf.mujoco.models import HOPPER, plant_of_text


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sound recording of a pendulum."""
    path = tmp_path_factory.mktemp("log") / "log.csv"
    write_recording(path, recorded("pendulum", 0)[0])
    return path


@pytest.fixture
def prompt(found: Gap, monkeypatch: pytest.MonkeyPatch) -> None:
    """An investigation that knows its result, and a page and a film that are drawn at once."""
    monkeypatch.setattr(mcpilco.gap, "investigate", lambda plant, recordings, **how: found)
    for module, name in (
        (mcpilco.show, "write_gap_film"),
        (mcpilco.show.report, "write_gap_report"),
    ):
        monkeypatch.setattr(module, name, lambda gap, path: path)


def found_in(out: Path, *files: Path, more: tuple[str, ...] = ()) -> int:
    plant = ["--plant", "mcpilco/Pendulum-v0"]
    return main(["gap", *map(str, files), *plant, "--out", str(out), *more])


@pytest.mark.usefixtures("prompt")
def test_an_earlier_result_is_overwritten_only_if_told(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("gap.json", "corrected.xml"):
        (tmp_path / name).write_text("earlier")
    assert found_in(tmp_path, log) == 2
    assert "gap.json exists already; nothing is overwritten" in capsys.readouterr().err
    assert (tmp_path / "gap.json").read_text() == "earlier"
    assert found_in(tmp_path, log, more=("--overwrite",)) == 0
    assert json.loads((tmp_path / "gap.json").read_text())["verdict"] == "named"
    assert not (tmp_path / "corrected.xml").exists()


@pytest.mark.usefixtures("prompt")
def test_stages_are_shown_with_their_times(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert found_in(tmp_path / "a", log) == 0
    told = capsys.readouterr().err
    assert re.search(r"check of the recordings: \d+\.\d s", told)
    assert re.search(r"drawing of report.html: \d+\.\d s", told)
    assert found_in(tmp_path / "b", log, more=("--quiet",)) == 0
    assert "check of the recordings" not in capsys.readouterr().err


@pytest.mark.usefixtures("prompt")
def test_names_that_come_back_are_told_and_kept(
    log: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    brake = Named("coulomb_friction", "pendulum", ("coulomb_friction",))
    told = Stability(
        (Repetition("one", "named", (brake,)), Repetition("two", "none", ())), (brake,)
    )
    monkeypatch.setattr(mcpilco.gap, "repetitions", lambda gap, **options: told)
    assert found_in(tmp_path, log, more=("--stability",)) == 0
    assert "coulomb_friction (pendulum) came back in 1 of 2" in capsys.readouterr().out
    kept = json.loads((tmp_path / "stability.json").read_text())
    assert kept["names"] == [
        {"name": brake.name, "target": brake.target, "family": [brake.name], "count": 1, "alike": 1}
    ]


def test_an_interrupted_run_keeps_the_stages_that_have_ended(
    log: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*told: Any, **how: Any) -> None:
        stages = logging.getLogger("mcpilco.gap.investigation")
        stages.info("search for effects", extra={"found": []})
        stages.info("verdict", extra={"found": ["coulomb_friction (pendulum)"]})
        raise KeyboardInterrupt

    monkeypatch.setattr(mcpilco.gap, "investigate", interrupted)
    out = tmp_path / "gap"
    assert found_in(out, log) == 130
    told = capsys.readouterr().err
    assert "2 stages had ended" in told
    assert "effects known by then: coulomb_friction (pendulum)" in told
    assert [path.name for path in out.iterdir()] == ["interrupted.json"]
    kept = json.loads((out / "interrupted.json").read_text())
    assert kept["ended"][-1]["stage"] == "search for effects"
    assert kept["ended"][-1]["effects"] == ["coulomb_friction (pendulum)"]
    assert kept["interrupted_in"] == "verdict"


@pytest.mark.usefixtures("prompt")
def test_a_page_that_finds_no_room_is_an_error(
    log: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(gap: Gap, path: Path) -> Path:
        raise RunFolderError(f"Cannot write {path}: No space left on device.")

    monkeypatch.setattr(mcpilco.show.report, "write_gap_report", full)
    assert found_in(tmp_path, log) == 1
    told = capsys.readouterr()
    assert "without report.html: Cannot write" in told.err
    assert "gap.json, corrected.json, gap.rrd." in told.out


@pytest.mark.slow
def test_a_file_that_is_given_three_times_holds_nothing_out(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "copy.csv"
    copy.write_bytes(log.read_bytes())
    assert found_in(tmp_path / "gap", log, log, copy) == 0
    told = capsys.readouterr().out
    assert "log holds the same as another file: it is counted once." in told
    assert "copy holds the same as log: it is counted once." in told
    assert told.splitlines()[0].endswith("(in-sample: nothing was held out).")
    assert "held-out" not in told
    used = json.loads((tmp_path / "gap" / "gap.json").read_text())["recordings"]
    assert used["train"] == ["log"]
    assert used["held_out"] == []
    page = (tmp_path / "gap" / "report.html").read_text()
    assert "in-sample: nothing was held out" in page
    assert "eld-out" not in page


@pytest.mark.parametrize(
    ("model", "columns", "more", "said"),
    [
        ("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>", {}, (), "can load:"),
        (HOPPER, {}, ("--keyframe", "low"), "has no keyframe 'low'; it has high."),
        (HOPPER, {"hip_servo": "hip_target"}, (), "expected a column for each of hip_servo, got"),
        (
            HOPPER.replace('<joint name="hip"', '<joint name="hip" stiffness="1e13"'),
            {},
            (),
            "it flies apart in most windows; choose a shorter timestep",
        ),
    ],
    ids=["not compiled", "no such keyframe", "other columns", "explodes"],
)
def test_a_model_that_cannot_be_compared_is_told_in_one_sentence(
    model: str,
    columns: dict[str, str],
    more: tuple[str, ...],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    plant, rng = plant_of_text(HOPPER), np.random.default_rng(0)
    u = np.repeat(rng.uniform(-0.5, 0.5, (40, 2)), 5, axis=0)
    y = plant.simulate(plant.rest[None], u[None], 0.02)[0] + rng.normal(0.0, 2e-3, (201, 10))
    names = [columns.get(name, name) for name in (*plant.layout.states, *plant.layout.inputs)]
    table = np.column_stack([0.02 * np.arange(201), y, np.append(u, u[-1:], axis=0)])
    log, robot = tmp_path / "log.csv", tmp_path / "robot.xml"
    np.savetxt(log, table, delimiter=",", header=",".join(["time", *names]), comments="")
    robot.write_text(model)
    asked = ["gap", str(log), "--plant", str(robot), "--out", str(tmp_path / "out"), "--quiet"]
    assert main([*asked, *more]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert told.count("error:") == 1
    assert told[told.index("error:") :].count("\n") == 1


@pytest.mark.usefixtures("prompt")
def test_events_of_the_collision_detector_mask_recordings(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    events = tmp_path / "collisions.json"
    events.write_text(json.dumps({"log": [{"start_s": 0.5, "end_s": 0.7, "joints": ["a"]}]}))
    assert found_in(tmp_path / "out", log, more=("--events", str(events))) == 0
    assert "log: 1 events are masked." in capsys.readouterr().err
    events.write_text('{"log": [{"begin": 0.5}]}')
    assert found_in(tmp_path / "again", log, more=("--events", str(events))) == 2
    assert "must be a collisions.json" in capsys.readouterr().err
    events.unlink()
    assert found_in(tmp_path / "again", log, more=("--events", str(events))) == 2
    assert "--events: cannot read" in capsys.readouterr().err
