"""The page of the real machines, their nominal plants, and how their recordings are cut."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from harness import marks

from mcpilco.bodies import generalised_forces, mass_matrix
from mcpilco.gap.report import to_json
from tests.mcpilco.gap.pushed import found  # noqa: F401  a fixture


def test_the_page_is_what_its_results_say(run, home):
    """Where it is not, `run.py --only-tables --data FOLDER` writes it."""
    begin, end = marks("results")
    text = (home / "README.md").read_text()
    written = text[text.index(begin) + len(begin) : text.index(end)].strip()
    assert written == "\n\n".join(part.strip() for part in run.page(home))


def test_the_page_tells_effects_errors_and_what_is_left(run, tmp_path, found):  # noqa: F811
    assert run.page(tmp_path) == ["Not measured yet."]
    asked = next(run.questions(("dfki_pendulum",)))
    told = json.loads(json.dumps(to_json(found), default=float))
    early = {"nominal": 9.0, "refit": 8.0, "corrected": 2.0}
    told |= {"early": early, "cpu_s": 12.0, "method": "of before", "host": {}}
    path = tmp_path / "results" / asked.file
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(told))
    origin, heading, effects, errors = run.page(tmp_path)
    assert "1 with code of which `mcpilco.gap` had the digest `of before`" in origin
    assert heading == "### dfki_pendulum"
    assert "coulomb_friction (pendulum)" in effects
    assert " N m (pendulum)" in effects
    assert "| mean after 0.5 s [noise std] | 9 | 8 | 2 |  | 75 |" in errors


def test_the_page_counts_the_names_that_come_back(run, tmp_path, found):  # noqa: F811
    asked = run.Question.repeated("quanser_qube")
    assert asked.held_out == "chirps"
    told = json.loads(json.dumps(to_json(found), default=float))
    told |= {"early": dict.fromkeys(run.MODELS, 1.0), "cpu_s": 12.0, "host": {}}
    lag = {"name": "sensor_lag", "target": "arm_velocity", "family": ["sensor_lag"]}
    gear = {"name": "back_emf", "target": "arm", "family": ["back_emf"]}
    repeated = {
        "held_out": asked.held_out,
        "verdict": "partly",
        "names": [lag | {"count": 3, "alike": 4}, gear | {"count": 1, "alike": 1}],
        "instead": {"spring (arm)": 2},
        "repetitions": 4 * [{}],
    }
    for path, content in (
        (f"results/{asked.file}", told),
        ("stability/quanser_qube.json", repeated),
    ):
        (tmp_path / path).parent.mkdir(parents=True)
        (tmp_path / path).write_text(json.dumps(content))
    heading, table = run.page(tmp_path)[-2:]
    assert heading == "### Do the names come back?"
    assert "1 of 2 names come back in at least 90 %" in table
    assert "| quanser_qube | chirps | partly | 4 | sensor_lag (arm_velocity) | 3 | 4 |  |" in table
    assert "|  |  |  |  | instead: spring (arm) |  |  | 2 |" in table


def test_every_machine_holds_out_some_of_its_recordings(run, data):
    for name, machine in run.MACHINES.items():
        dt = machine.dts_ms[0] / 1e3
        names = {recording.name for recording in machine.recordings(data, dt)}
        for unseen in machine.held_out.values():
            assert set(unseen) < names, name


def test_the_parts_of_a_recording_follow_one_another(run, data):
    parts = run.MACHINES["emps"].recordings(data, 0.01)
    assert [part.name for part in parts] == ["emps_1", "emps_2", "emps_3"]
    assert sum(len(part) * part.dt for part in parts) == pytest.approx(24.84, abs=0.05)
    for one, other in itertools.pairwise(parts):
        assert abs(other.states[0, 0] - one.states[-1, 0]) < 3e-3


def test_the_nominal_double_pendulum_is_the_authors_model(run):
    """Mass matrix and weights of their equations, with inertias about the joints."""
    (m1, m2), (c1, c2) = (0.5234602302310271, 0.6255677234174437), (0.2, 0.25569305436052964)
    (I1, I2), l1, g, q = (0.031887199591513114, 0.05086984812807257), 0.2, 9.81, 0.7
    chain = run.MACHINES["dfki_double_pendulum"].plant().chain
    coupling = m2 * l1 * c2 * np.cos(q)
    M = [[I1 + I2 + m2 * l1**2 + 2 * coupling, I2 + coupling], [I2 + coupling, I2]]
    still = np.zeros((1, 2))
    np.testing.assert_allclose(mass_matrix(chain, np.array([[0.3, q]]))[0], M, rtol=1e-9)
    weight = generalised_forces(chain, np.array([[0.3, q]]), still, still)[0]
    lower = m2 * g * c2 * np.sin(0.3 + q)
    upper = (m1 * c1 + m2 * l1) * g * np.sin(0.3)
    np.testing.assert_allclose(weight, [upper + lower, lower], rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("third", ["third 1", "third 2", "third 3"])
def test_the_drive_has_viscous_and_dry_friction_that_differ_by_direction(run, data, third):
    """Published: 203.5 N s/m, 20.39 N, and an offset, which least squares prefer less than this."""
    gap = run.find(run.Question("emps", third, 20.0), data)
    named = {effect.name: effect.parameters for effect in gap.named}
    viscous, dry = (
        [each.value for name in names for each in named.pop(name, {}).values()]
        for names in (
            ("viscous_friction", "asymmetric_viscous_friction"),
            ("coulomb_friction", "asymmetric_friction"),
        )
    )
    assert np.mean(viscous) == pytest.approx(203.5, rel=0.1)
    assert np.mean(dry) == pytest.approx(20.39, rel=0.1)
    assert len(viscous) + len(dry) > 2 or set(named) == {"constant_force"}
    assert set(named) <= {"constant_force"}
    assert gap.comparison is not None
    assert gap.comparison.channels["slide_position"]["corrected"] < 2.5e-3
