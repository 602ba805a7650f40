"""Laws of the task's description: what is refused, and what a file keeps of it."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
import torch

from mcpilco.task import TaskSpec
from mcpilco.typing import Cost, InputError


def test_all_but_the_cost_survives_json(task: TaskSpec) -> None:
    read = TaskSpec.from_json(json.loads(json.dumps(task.to_json())))
    assert dataclasses.replace(read, cost=task.cost) == task


def test_numpy_numbers_survive_json(task: TaskSpec) -> None:
    given = dataclasses.replace(
        task, dt=np.float32(0.5), start_std=np.full(4, 0.25), angles=(np.int64(2),)
    )
    read = TaskSpec.from_json(json.loads(json.dumps(given.to_json())))
    assert (read.dt, read.start_std, read.angles) == (0.5, (0.25,) * 4, (2,))


def test_a_task_from_a_file_says_that_it_has_no_cost(task: TaskSpec) -> None:
    cost = TaskSpec.from_json(task.to_json()).cost
    assert isinstance(cost, Cost)
    with pytest.raises(InputError, match="pass the env"):
        cost(torch.zeros(3, 4), torch.zeros(3, 1))


@pytest.mark.parametrize(
    ("entry", "wrong", "message"),
    [
        ("state_units", ("m",), "one entry for each of the 4 states"),
        ("start_mean", (0.0,) * 5, "one entry for each of the 4 states"),
        ("start_mean", (0.0, 0.0, 0.0, math.inf), "finite"),
        ("start_std", (0.1, 0.1, 0.1, -0.1), "not negative"),
        ("start_std", (0.1, 0.1, 0.1, math.nan), "finite"),
        ("input_units", (), "input_units"),
        ("dt", 0.0, "positive"),
        ("dt", math.nan, "positive"),
        ("dt", "0.1", "entry of another type .*dt is a number"),
        ("angles", 2, "entry of another type .*angles a tuple of indices"),
        ("velocities", (0, 1), "entry of another type .*pairs of indices"),
        ("start_std", 0.1, "entry of another type .*tuples of numbers"),
        ("angles", (4,), r"index the 4 states from 0, got \[4\]"),
        ("velocities", ((0, -1),), "index the 4 states"),
        ("velocities", ((0, 1), (1, 3)), "the position of no other pair"),
        ("velocities", ((0, 1), (0, 3)), "each position one velocity"),
        ("measured", (0, 1), "tells nothing of pole_angle, pole_velocity"),
        ("measured", (0, 2, 2), "must index different states"),
        ("measured", (0, 2, 4), "must index different states"),
        ("measurement_std", (0.1,) * 4, "belongs to states measured in part"),
        ("goal", (0.0,) * 3, "one finite entry for each of the 4 states"),
        ("goal", (0.0, 0.0, math.nan, 0.0), "one finite entry"),
        ("goal", (0.0, 0.0, 3.0, 1.0), "a state of rest, got a velocity in pole_velocity"),
    ],
)
def test_what_does_not_fit_is_answered_with_a_sentence(
    task: TaskSpec, entry: str, wrong, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        dataclasses.replace(task, **{entry: wrong})


@pytest.mark.parametrize("stds", [(0.1,), (0.1, 0.0), (0.1, math.nan)])
def test_noise_is_positive_and_one_for_each_measured_state(task: TaskSpec, stds) -> None:
    with pytest.raises(InputError, match="one for each of the 2 measured states"):
        dataclasses.replace(task, measured=(0, 2), measurement_std=stds)


def test_observed_are_the_measured_states_or_all(task: TaskSpec) -> None:
    assert task.measured_states == (0, 1, 2, 3)
    measured = dataclasses.replace(task, measured=(2, 0), measurement_std=(0.1, 0.2))
    assert measured.measured_states == (2, 0)
    assert TaskSpec.from_json(json.loads(json.dumps(measured.to_json()))).measured_states == (2, 0)
