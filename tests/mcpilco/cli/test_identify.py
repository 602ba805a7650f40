"""Laws of `mcpilco identify`: columns, files that are written, sentences for what is wrong."""

from __future__ import annotations

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mcpilco.agent import with_model
from mcpilco.cli import main
from mcpilco.config import Config
from mcpilco.identification import (
    RigidBody,
    base_parameters,
    random_motions,
    write_identified_mjcf,
)
from mcpilco.identification.rigid_body import projection
from mcpilco.plant import read_correction
from mcpilco.recordings import load_robot, read_robot
from mcpilco.typing import InputError
from tests.mcpilco.identification.rigid_body.log import XML, heavier, segment, write

PART = segment(heavier(), noise=1e-4, force_noise=0.05)


@pytest.fixture
def robot(tmp_path):
    """Path of the model."""
    path = tmp_path / "robot.xml"
    path.write_text(XML)
    return path


def refused(capsys, *arguments) -> str:
    assert main(["identify", *map(str, arguments)]) == 2
    return capsys.readouterr().err.strip().splitlines()[-1].removeprefix("mcpilco: error: ")


def beta(model) -> np.ndarray:
    """Base parameters of a model."""
    body = RigidBody.of(model, ("viscous",))
    base = base_parameters(body.regressor(*random_motions(body, 300, np.random.default_rng(0))))
    return base.of(body.nominal)


def test_the_identified_model_is_that_of_the_robot_and_all_is_written(tmp_path, robot, capsys):
    log = write(tmp_path / "log.csv", PART)
    out = tmp_path / "out"
    arguments = ["identify", str(log), "--model", str(robot), "--out", str(out)]
    assert main([*arguments, "--terms", "viscous"]) == 0
    printed = capsys.readouterr().out
    assert "shoulder_viscous" in printed
    assert "+-" in printed
    found = json.loads((out / "identified.json").read_text())["about"]
    assert all(link["consistent"] for link in found["links"].values())
    assert found["held_out"]["elbow"]["error_rms"] < 0.1 * found["held_out"]["elbow"]["force_rms"]
    identified = mujoco.MjModel.from_xml_path(str(out / "identified.xml"))
    truth, before = beta(heavier()), beta(mujoco.MjModel.from_xml_path(str(robot)))
    now = beta(identified)
    assert np.linalg.norm(now - truth) < 0.05 * np.linalg.norm(before - truth)


def test_a_search_that_did_not_converge_is_told(tmp_path, robot, capsys, monkeypatch):
    log = write(tmp_path / "log.csv", segment(heavier(), noise=3e-3, force_noise=1.0))
    arguments = ["identify", str(log), "--model", str(robot), "--out", str(tmp_path / "out")]
    for rounds, converged in ((projection._ROUNDS, True), (2, False)):
        monkeypatch.setattr(projection, "_ROUNDS", rounds)
        assert main([*arguments, "--method", "OLS", "--terms", "viscous"]) == 0
        assert ("pseudo-inertia did not converge" in capsys.readouterr().out) == (not converged)
        found = json.loads((tmp_path / "out" / "identified.json").read_text())["about"]
        assert found["converged"] == converged


def test_commands_of_motors_say_the_same_as_forces(tmp_path, robot):
    model = load_robot(robot)
    ((torques,), _, _), ((commands,), _, _) = (
        read_robot([write(tmp_path / f"{name}.csv", PART, motors)], model)
        for name, motors in (("torques", False), ("commands", True))
    )
    held = 0.5 * (PART.tau[1:] + PART.tau[:-1])  # a command acts until the next
    np.testing.assert_allclose(torques.tau, PART.tau, rtol=1e-9)
    np.testing.assert_allclose(commands.tau[1:], np.clip(held, -30, 30), rtol=1e-9)


def test_a_written_model_has_the_parameters_that_were_given(tmp_path, robot):
    model = load_robot(robot)
    terms = ("viscous", "coulomb", "armature", "stiffness", "offset")
    body = RigidBody.of(model, terms)
    theta = RigidBody.of(heavier(), terms).nominal.reshape(-1, body.width).copy()
    theta[:, 10:] = [0.4, 0.2, 0.05, 3.0, -0.6]
    path = tmp_path / "deeper" / "written.xml"
    path.parent.mkdir()
    write_identified_mjcf(robot, body, theta.ravel(), path)
    again = RigidBody.of(mujoco.MjModel.from_xml_path(str(path)), terms).nominal
    np.testing.assert_allclose(again, theta.ravel(), rtol=1e-4, atol=1e-5)
    wrong = theta.copy()
    wrong[0, 0] = -1.0
    with pytest.raises(InputError, match="mass -1 kg is not positive"):
        write_identified_mjcf(robot, body, wrong.ravel(), path)


def test_what_is_wrong_with_files_is_said(tmp_path, robot, capsys):
    log, out = write(tmp_path / "log.csv", PART), tmp_path / "out"
    rest = ("--model", robot, "--out", out)
    text = log.read_text()
    (tmp_path / "other.csv").write_text(text.replace("elbow_position", "knee_position"))
    assert main(["identify", str(tmp_path / "other.csv"), *map(str, rest)]) == 2
    assert "expected a column for each of elbow_position" in capsys.readouterr().err
    still = replace(PART, q=PART.q * [1.0, 0.0])
    assert "joint 'elbow' must move" in refused(capsys, write(tmp_path / "still.csv", still), *rest)
    short = segment(heavier(), seconds=0.3)
    assert "record for longer" in refused(capsys, write(tmp_path / "short.csv", short), *rest)
    assert "is no file" in refused(capsys, log, "--model", tmp_path / "no.xml", "--out", out)
    assert not out.exists()


@pytest.mark.parametrize(
    ("inside", "sentence"),
    [
        ('<freejoint/><geom size="0.1"/>', "1 free or ball joints"),
        ('<joint name="a"/><joint name="b" axis="1 0 0"/><geom size="0.1"/>', "one joint, got 2"),
        ('<joint/><geom size="0.1"/>', "each joint must have a name"),
    ],
)
def test_what_is_wrong_with_a_model_is_said(tmp_path, robot, capsys, inside, sentence):
    path = tmp_path / "wrong.xml"
    path.write_text(f"<mujoco><worldbody><body>{inside}</body></worldbody></mujoco>")
    log = write(tmp_path / "log.csv", PART)
    assert sentence in refused(capsys, log, "--model", path, "--out", tmp_path / "out")


def test_train_reads_what_was_identified_of_a_plant_and_of_an_mjcf(tmp_path, robot):
    log, plant = write(tmp_path / "log.csv", PART), "mcpilco/DoublePendulum-v0"
    for name, out in ((str(robot), "file"), (plant, "known")):
        columns = ["--columns", "shoulder_position=shoulder_position"]
        columns += ["elbow_position=elbow_position"] if name == plant else []
        columns += ["shoulder_velocity=none", "elbow_velocity=none"] if name == plant else []
        arguments = ["identify", str(log), "--model", name, "--out", str(tmp_path / out)]
        assert main([*arguments, "--terms", "viscous", *columns]) == 0
        path = tmp_path / out / "identified.json"
        model = with_model(Config(), "physics+rbf", path).model
        assert model.uncertainty == "told"
        (member,) = read_correction(path).spread
        assert min(member.values.values()) > 0.0
        assert model.plant["plant"] == ("identified" if name != plant else plant)
        assert ("mjcf" in model.plant) == (name != plant)
