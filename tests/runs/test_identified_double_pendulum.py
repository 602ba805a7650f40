from __future__ import annotations

import sys

import numpy as np
import pytest

from mcpilco.identification import base_parameters, check_links
from mcpilco.recordings import Recording


def simulated(run, theta: np.ndarray) -> Recording:
    """Ten seconds of a double pendulum with these parameters, without noise."""
    t = run.DT * np.arange(5000)
    torque = np.stack(
        [
            0.7 * np.sin(2.0 * np.pi * (0.4 + 0.05 * t) * t),
            0.6 * np.sin(2.0 * np.pi * (0.9 - 0.04 * t) * t + 1.0),
        ],
        axis=1,
    )
    plant = run.judge.plant(run.published(), theta, run.judge.TURN)
    states = plant.simulate(np.zeros((1, 4)), torque[None], run.DT)[0, :-1]
    layout = plant.layout
    return Recording("simulated", t, states, torque, layout.states, layout.inputs)


@pytest.fixture(scope="module")
def truth(run):
    """Parameters that are not the authors': heavier or lighter bodies, other friction."""
    robot, rng = run.published(), np.random.default_rng(0)
    blocks = robot.nominal.reshape(-1, robot.width).copy()
    blocks[:, :10] *= rng.uniform(0.7, 1.3, (2, 1))
    blocks[:, 10:] *= rng.uniform(0.7, 1.3, (2, 3))
    theta = blocks.ravel()
    assert all(link.consistent for link in check_links(robot, theta))
    return robot, theta


def test_the_parameters_of_a_simulation_are_found(run, truth):
    robot, theta = truth
    motion = run.Motion.of(simulated(run, theta))
    base = base_parameters(run.rows(robot, motion)[0])
    found = run.fit(robot, motion, "OLS")
    assert all(link.consistent for link in check_links(robot, found))
    wrong, known = base.of(found) - base.of(theta), base.of(theta)
    felt = np.abs(known) > 1e-9
    assert np.median(np.abs(wrong[felt] / known[felt])) < 0.05


def test_true_parameters_predict_without_error(run, truth):
    robot, theta = truth
    errors = run.judge.errors(robot, theta, run.Motion.of(simulated(run, theta)))
    assert (errors.angle < 0.01).all()


@pytest.mark.slow
def test_the_real_recordings_fill_the_page(run, data, tmp_path, monkeypatch):
    words = ["run.py", "--data", str(data), "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    assert run.main() == 0
    page = (tmp_path / "README.md").read_text()
    assert "Not measured yet" not in page
    assert "| authors |" in page
    assert "elbow_coulomb" in page
