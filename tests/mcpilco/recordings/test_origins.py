"""The ways in which a plant and its recordings may go together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import envs
from mcpilco.mjcf import plant_of
from mcpilco.plant import Plant
from mcpilco.recordings import Recording, possible_origins
from mcpilco.recordings.origins import STEPS
from tests.mcpilco.mjcf.test_models import PENDULUM

DT = 0.02


def recorded(plant: Plant) -> Recording:
    time = DT * np.arange(50)
    states = np.stack([np.sin(3.0 * time), 3.0 * np.cos(3.0 * time)], axis=1)
    names = plant.layout.states, plant.layout.inputs
    return Recording("log", time, states, np.ones((50, 1)), *names, velocities=((0, 1),))


def test_without_doubt_there_is_one() -> None:
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    recording = recorded(plant)
    assert possible_origins(plant, [recording]) == [(plant, (recording,))]


def test_commands_that_a_clock_sent_come_before_those_as_stamped() -> None:
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    recording = replace(recorded(plant), by_clock=np.zeros((50, 1)))
    (_, (first,)), (_, (second,)) = possible_origins(plant, [recording])
    assert second is recording
    assert not first.inputs.any()


@pytest.fixture
def of_a_file(tmp_path: Path) -> Plant:
    """In timesteps of 4 ms."""
    path = tmp_path / "robot.xml"
    path.write_text(PENDULUM.format(how="implicitfast", step=4e-3, flags=""))
    return plant_of(path)


def test_what_a_simulator_made_has_positions_of_half_a_timestep_later(of_a_file: Plant) -> None:
    recording = recorded(of_a_file)
    (plant, (same,)), *others = possible_origins(of_a_file, [recording])
    assert plant is of_a_file
    assert same is recording
    assert [stepped for stepped, _ in others] == [of_a_file.in_steps(part) for part in STEPS]
    for part, (_, (moved,)) in zip(STEPS, others, strict=True):
        late = part * 2e-3
        np.testing.assert_allclose(moved.states[:, 0], np.sin(3.0 * (moved.time - late)), atol=2e-5)
        np.testing.assert_array_equal(moved.states[:, 1], recording.states[:, 1])


def test_velocities_that_were_not_measured_are_slopes(of_a_file: Plant) -> None:
    recording = recorded(of_a_file)
    recording.states[:, 1] = np.nan
    (_, (moved,)) = possible_origins(of_a_file, [recording])[1]
    expected = np.sin(3.0 * (moved.time - 2e-3))
    np.testing.assert_allclose(moved.states[1:-1, 0], expected[1:-1], atol=3e-5)
    assert np.isnan(moved.states[:, 1]).all()
