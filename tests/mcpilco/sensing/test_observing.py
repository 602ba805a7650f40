"""Laws of how a state is made of an observation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcpilco.agent import run_episode
from mcpilco.sensing.observing import state_of, state_view, unwrapped
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError
from tests.mcpilco.swinging import CIRCLE, DT, TASK, Swinging

CIRCULAR = replace(TASK, **CIRCLE)


def episode(env, task: TaskSpec):
    return run_episode(state_view(env, task), lambda _: np.array([5.0]), 40, DT, seed=3)


def test_an_observation_that_is_the_state_is_taken_as_it_is() -> None:
    env = Swinging()
    assert state_view(env, TASK) is env
    observation = np.array([4.0, 1.0])
    assert state_of(TASK, observation) is observation


@pytest.mark.parametrize("angle", [-3.1, -1.0, 0.0, 2.0, 3.1])
def test_an_angle_is_found_again_from_its_cosine_and_sine(angle: float) -> None:
    observation = np.array([np.cos(angle), np.sin(angle), 7.0])
    np.testing.assert_allclose(state_of(CIRCULAR, observation), [angle, 7.0], atol=1e-12)
    batch = np.tile(observation, (4, 5, 1))
    assert state_of(CIRCULAR, batch).shape == (4, 5, 2)


def test_states_are_chosen_and_ordered_as_the_task_says() -> None:
    task = replace(TASK, angles=(), velocities=(), observed=(2, 0))
    np.testing.assert_array_equal(state_of(task, np.array([1.0, 2.0, 3.0])), [3.0, 1.0])


@pytest.mark.parametrize(("view", "observed"), [("circle", ((0, 1), 2)), ("wrapped", (0, 1))])
def test_angles_count_turns_whatever_the_env_shows_of_them(view: str, observed: tuple) -> None:
    """The pendulum, pushed into turns, looks like the one whose env tells the angle itself."""
    told = episode(Swinging(push=12.0), TASK)
    seen = episode(Swinging(view, push=12.0), replace(TASK, observed=observed))
    assert np.ptp(told.observations[:, 0]) > 2 * np.pi
    np.testing.assert_allclose(seen.observations, told.observations, atol=1e-9)


def test_unwrapping_takes_the_nearest_turn_and_leaves_what_is_no_angle() -> None:
    state = unwrapped(TASK, np.array([13.0, 0.0]), np.array([0.2, 9.0]))
    np.testing.assert_allclose(state, [0.2 + 4 * np.pi, 9.0])


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"observed": ((0, 1),)}, "say for each of the states"),
        ({"observed": ((0, 1, 2), 2)}, "pairs of them"),
        ({"observed": ((0, 1), -1)}, "must hold indices"),
        ({"observed": ((0, 1), 2.5)}, "must hold indices"),
        ({"observed": ((0, 1), 2), "angles": ()}, "TaskSpec.angles must name too"),
    ],
)
def test_what_cannot_be_observed_is_answered_with_a_sentence(entries: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(TASK, **entries)


def test_a_task_with_observed_survives_json() -> None:
    assert TaskSpec.from_json(CIRCULAR.to_json(), None) == CIRCULAR
