"""Laws of the look at an env: good ones have no fault, and each single fault is named."""

from __future__ import annotations

import re
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box, Dict, Discrete
from gymnasium.wrappers import TimeLimit

from mcpilco.agent.inspection import inspect_env
from mcpilco.policies import SaturatingCost
from tests.mcpilco.swinging import CIRCLE, TASK, Swinging

COST = SaturatingCost((0,), (0.0,), (1.0,), (False,))
GIVEN = replace(TASK, cost=COST)


def look(env, task=TASK, horizon: int | None = 40, **settings):
    return list(inspect_env(env, task, horizon=horizon, steps=160, **settings))


def faults(env, task=TASK, horizon: int | None = 40) -> list[str]:
    return [found.sentence for found in look(env, task, horizon) if found.kind == "fault"]


def notes(env, task=TASK, horizon: int | None = 40) -> str:
    return " ".join(found.sentence for found in look(env, task, horizon) if found.kind == "note")


@pytest.mark.parametrize(
    ("env", "task"),
    [
        (Swinging(), TASK),
        (Swinging(push=12.0), replace(TASK, start_mean=(0.5, 12.0))),
        (Swinging("circle"), replace(TASK, **CIRCLE)),
        (Swinging("wrapped"), replace(TASK, observed=(0, 1))),
        (Swinging("noisy"), GIVEN),
        (Swinging(silent=True), GIVEN),
    ],
)
def test_good_envs_have_no_fault(env: Swinging, task) -> None:
    assert faults(env, task) == []


def spaces(**changed: gym.Space) -> Swinging:
    env = Swinging()
    for name, space in changed.items():
        setattr(env, name, space)
    return env


@pytest.mark.parametrize(
    ("env", "task", "sentence"),
    [
        (spaces(observation_space=Dict(x=Box(-1, 1))), TASK, "one-dimensional Box observation"),
        (spaces(action_space=Discrete(2)), TASK, "one-dimensional Box action"),
        (Swinging(limit=np.inf), TASK, "finite action bounds"),
        (Swinging(), None, "no attribute `task`"),
        (Swinging(nan_at=7), TASK, "finite numbers .* at step 7"),
        (Swinging(push=3.0), TASK, "start with velocity at .*the task says 0 "),
        (Swinging(), replace(TASK, start_std=(0.1, 1.0)), "start with velocity"),
        (Swinging(), replace(TASK, dt=0.05), "as if dt were 0.1"),
        (Swinging(), replace(TASK, cost=lambda x, u: x[..., 7]), "cost .* raised IndexError"),
        (Swinging(), replace(TASK, cost=lambda x, u: x[..., 0] / 0), "cost .* not finite"),
        (Swinging(), replace(TASK, cost=lambda x, u: (1 - x[..., 0]).log()), "not finite at "),
        (Swinging(silent=True), TASK, "All rewards are equal"),
        (Swinging("wrapped", push=12.0), replace(TASK, start_mean=(0.5, 12.0)), "full turn"),
        (
            Swinging("positions"),
            replace(
                GIVEN,
                state_names=("angle",),
                state_units=("rad",),
                velocities=(),
                start_mean=(0.5,),
                start_std=(0.1,),
            ),
            "not Markov: the one-step prediction error of angle .* A velocity or another state",
        ),
        (
            Swinging("circle"),
            replace(
                GIVEN,
                state_names=("c", "s", "velocity"),
                state_units=("-", "-", "rad/s"),
                angles=(),
                velocities=(),
                start_mean=(0.87, 0.48, 0.0),
                start_std=(0.05, 0.088, 0.1),
            ),
            "0 and 1 look like cosine and sine",
        ),
    ],
)
def test_each_single_fault_is_the_only_one_named(env: Swinging, task, sentence: str) -> None:
    found = faults(env, task)
    assert len(found) == 1, found
    assert re.search(sentence, found[0]), found


def test_an_env_without_end_asks_for_a_horizon() -> None:
    assert "--horizon" in " ".join(faults(Swinging(), GIVEN, horizon=None))


def test_what_is_only_worth_knowing_is_a_note() -> None:
    assert "Equal seeds of reset give different starts" in notes(Swinging(unseeded=True))
    assert "lasts" in notes(Swinging(ends=0.4))
    assert "long to roll particles out" in notes(Swinging(), horizon=500)


def test_a_time_limit_is_no_early_end() -> None:
    limited = TimeLimit(Swinging(), max_episode_steps=20)
    assert "lasts" not in notes(limited, horizon=None)
    assert "lasts" not in notes(limited, horizon=60)


def test_a_start_all_around_the_circle_is_a_note_and_no_fault() -> None:
    env = gym.make("Pendulum-v1")
    found = list(inspect_env(env, steps=160))
    assert [finding for finding in found if finding.kind == "fault"] == []
    text = " ".join(finding.sentence for finding in found)
    assert "guessed from its class" in text
    assert "anywhere around the circle of angle" in text


def test_equal_seeds_give_equal_findings() -> None:
    assert look(Swinging("noisy"), seed=3) == look(Swinging("noisy"), seed=3)


def test_velocities_that_the_agent_estimates_are_no_fault() -> None:
    part = replace(TASK, measured=(0,), measurement_std=(0.01,))
    assert faults(Swinging("positions"), part) == []
    assert "estimated by the agent: velocity" in notes(Swinging("positions"), part)
