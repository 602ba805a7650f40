"""`mcpilco cross`, from recordings to the story."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import mcpilco.agent.agent
from mcpilco.cli import cross as command
from mcpilco.cli import main
from mcpilco.crossing import workflow
from mcpilco.logbook import RunFolder
from mcpilco.recordings import require_plausible
from mcpilco.sweep import job
from tests.mcpilco.cli.test_cli import refused
from tests.mcpilco.fakes import FakeAgent
from tests.mcpilco.rigs import rig

HINDERED = {
    "format": 1,
    "plant": "mcpilco/CartPoleSwingUp-v0",
    "parameters": {},
    "effects": [{"name": "coulomb_friction", "target": "cart", "parameters": {"f_c": 2.0}}],
}
FEW = ["--seconds", "6", "--rollouts", "2", "--trials", "2", "--episodes", "3", "--quiet"]


@pytest.fixture
def hindered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A system with friction, in a folder to work in; an agent that learns nothing."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(mcpilco.agent.agent, "MCPILCO", FakeAgent)
    (tmp_path / "hidden.json").write_text(json.dumps(HINDERED))
    return tmp_path


class Found:
    """An investigation that finds at once what is hidden, in place of one that takes minutes."""

    verdict = "named"
    comparison = None
    times = 0


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> type[Found]:
    """Replaces the investigation."""

    def investigate(plant, recordings, **options) -> Found:
        Found.times += 1
        return Found()

    def write_gap(gap: Found, path: Path) -> None:
        effect = {
            "name": "coulomb_friction",
            "target": "cart",
            "parameters": {"f_c": {"value": 2.0, "low": 1.9, "high": 2.1, "unit": "N"}},
        }
        effects = [effect] if gap.verdict == "named" else []
        content = {"verdict": gap.verdict, "effects": effects, "error": {"closed": {"value": 0.99}}}
        path.write_text(json.dumps(content))

    def write_correction(path: Path, correction: Any) -> Path:
        path.write_text(json.dumps(HINDERED))
        return path

    monkeypatch.setattr(Found, "times", 0)
    monkeypatch.setattr(Found, "verdict", "named")
    monkeypatch.setattr(workflow, "investigate", investigate)
    monkeypatch.setattr(workflow, "write_gap", write_gap)
    monkeypatch.setattr(workflow, "write_correction", write_correction)
    monkeypatch.setattr(Found, "correction", None, raising=False)
    monkeypatch.setattr(command, "show_gap", lambda gap, out, written: None)
    return Found


def crossed(*more: str) -> int:
    return main(["cross", "--out", "out", "--env-kwargs", "effects=hidden.json", *FEW, *more])


def test_all_stages_lead_to_the_story(hindered: Path, found, capsys) -> None:
    assert crossed() == 0
    told = capsys.readouterr().out
    assert "Trained in the nominal simulation: it promised" in told
    assert "Trained in the corrected simulation: it promised" in told
    assert len(list((hindered / "out" / "recordings").glob("*.csv"))) == 2
    corrected = RunFolder.open(hindered / "out" / "corrected")
    assert corrected.config["env_kwargs"]["effects"] == HINDERED
    assert "effects" not in RunFolder.open(hindered / "out" / "nominal").config["env_kwargs"]
    page = (hindered / "out" / "report.html").read_text()
    assert "coulomb_friction" in page
    assert "2 N (1.9 to 2.1)" in page
    assert "Over 3 fresh episodes in the simulation and 3 on the system" in page
    assert (hindered / "out" / "crossing.rrd").exists()


@pytest.mark.slow
def test_the_same_command_goes_on_where_it_was_stopped(hindered: Path, found, capsys) -> None:
    assert crossed() == 0
    out = hindered / "out"
    kept = {path: path.stat().st_mtime_ns for path in (out / "recordings").glob("*.csv")}
    before = (out / "corrected.json").read_text()
    for lost in ("corrected.json", "report.html", "recordings/excitation-seed1-00.csv"):
        (out / lost).unlink()
    capsys.readouterr()
    assert crossed() == 0
    assert found.times == 1
    assert (out / "corrected.json").read_text() == before
    first = out / "recordings" / "excitation-seed0-00.csv"
    assert first.stat().st_mtime_ns == kept[first]
    assert (out / "recordings" / "excitation-seed1-00.csv").exists()


def test_a_folder_of_other_settings_is_refused(hindered: Path, found, capsys) -> None:
    assert crossed() == 0
    capsys.readouterr()
    sentence = refused(capsys, "cross", "--out", "out", *FEW, "--seed", "1")
    assert "another env_kwargs, seed" in sentence


def test_recordings_that_look_wrong_end_the_crossing_until_they_are_accepted(
    hindered: Path, found, monkeypatch, capsys
) -> None:
    given = []
    replaced = workflow.investigate

    def investigate(*args: Any, accepted: Any, **options: Any) -> Found:
        given.append(accepted)
        if accepted is None:
            require_plausible(["negate force?"])
        return replaced(*args, **options)

    monkeypatch.setattr(workflow, "investigate", investigate)
    sentence = refused(capsys, "cross", "--out", "out", "--env-kwargs", "effects=hidden.json", *FEW)
    assert "negate force? Nothing was searched for; mend the columns, or" in sentence
    assert "--accept" in sentence
    assert crossed("--accept") == 0
    assert given == [None, ()]  # all that there are


def test_too_little_data_ends_the_crossing(hindered: Path, found, monkeypatch, capsys) -> None:
    monkeypatch.setattr(found, "verdict", "too_poor")
    assert "record for longer" in refused(capsys, "cross", "--out", "out", *FEW)
    assert not (hindered / "out" / "nominal").exists()


def test_an_interruption_keeps_the_stages_and_names_the_same_command(
    hindered: Path, found, monkeypatch, capsys
) -> None:
    def stop(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(workflow.Workflow, "attempt", stop)
    assert crossed() == 130
    error = capsys.readouterr().err
    assert "the same command goes on" in error
    assert "--resume" not in error
    assert (hindered / "out" / "nominal" / "summary.json").exists()


@pytest.mark.slow
def test_no_attempt_is_asked_again_of_a_system_that_takes_one_at_a_time(
    hindered: Path, found, monkeypatch, capsys
) -> None:
    show, asked = command.Cross._show, []

    def stop(*told: Any) -> None:
        asked.append(told[1])
        show(*told)
        if len(asked) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(job, "_vector_form", lambda *arguments: None)
    monkeypatch.setattr(command.Cross, "_show", stop)
    assert crossed() == 130
    assert "the same command goes on" in capsys.readouterr().err
    assert crossed() == 0
    assert asked == [1, 2, 3, 1, 2, 3]


def test_a_plant_without_an_env_is_not_offered_as_a_simulation(hindered: Path, capsys) -> None:
    sentence = refused(capsys, "cross", "--out", "new", "--sim", "nothing")
    offered = sentence.partition("must be one of ")[2].split(", ")
    assert "mcpilco/Acrobot-v0" in offered
    assert "mcpilco/DoublePendulum-v0" not in offered


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--sim", "CartPole-v1"], "--sim must be one of mcpilco/CartPoleSwingUp-v0"),
        (["--sim", "mcpilco/DoublePendulum-v0"], "--sim must be one of mcpilco/CartPoleSwingUp-v0"),
        (["--sim-kwargs", "effects=hidden.json"], "must leave out effects"),
        (["--sim-kwargs", "wheel=3"], "has no keyword wheel"),
        (["--env-kwargs", "effects=nowhere.json"], "cannot read nowhere.json"),
        (["--env-kwargs", "wheel=3"], "has no keyword wheel"),
        (["--env-kwargs", "effects"], "--env-kwargs must be NAME=VALUE, got 'effects'"),
        (["--episodes", "0"], "--episodes must be at least 1"),
    ],
)
def test_wrong_arguments_are_refused_before_a_folder_is_made(
    hindered: Path, capsys, arguments: list[str], sentence: str
) -> None:
    assert sentence in refused(capsys, "cross", "--out", "new", *arguments)
    assert not (hindered / "new").exists()


@pytest.mark.slow
def test_a_crossing_meets_a_machine_whose_address_stands_in_no_file(hindered, found) -> None:
    few = ["--seconds", "1", "--rollouts", "1", "--attempts", "1", "--trials", "1", "--quiet"]
    patient = ["--machine-kwargs", "watchdog=2", "silence=2", "--dt", "0.02"]
    command = ["cross", "--out", "out", "--episodes", "2", *few, *patient, "--machine"]
    with rig() as machine:
        assert main([*command, machine.address]) == 0
        assert main([*command, machine.address]) == 0
    out = hindered / "out"
    assert len(list((out / "machine").glob("*.csv"))) == 5
    assert json.loads((out / "nominal.json").read_text())["happened"]["episodes"] == 1
    written = "".join(path.read_text() for path in out.rglob("*.json"))
    assert machine.address not in written
    assert main([*command[:-1]]) == 2
