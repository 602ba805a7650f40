"""Laws of the contract with an env: what fits is described, what does not gets a sentence."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.envs.registration import EnvSpec
from gymnasium.spaces import Box, Dict, Discrete
from gymnasium.wrappers import TimeLimit

from mcpilco.agent.algorithms import names_in
from mcpilco.agent.contract import (
    AbsentEnv,
    check_cost,
    horizon_of,
    input_bounds,
    make_env,
    task_of,
)
from mcpilco.config import Config
from mcpilco.sweep import Settings
from mcpilco.typing import EnvError, InputError
from tests.mcpilco.point import TASK, PointEnv


def with_spaces(**spaces: gym.Space) -> PointEnv:
    env = PointEnv()
    for name, space in spaces.items():
        setattr(env, name, space)
    return env


def test_an_env_is_taken_as_it_is() -> None:
    env = PointEnv()
    assert make_env(env) is env


def test_an_id_is_made_with_its_keywords() -> None:
    gym.register("tests/Point-v0", entry_point=PointEnv, max_episode_steps=7)
    try:
        env = make_env("tests/Point-v0", limit=3.0)
        assert input_bounds(env)[1] == [3.0]
        assert horizon_of(env, None) == 7
        assert task_of(env, None) is TASK  # through the wrappers
        with pytest.raises(EnvError, match="Cannot make the env 'tests/Point-v0'"):
            make_env("tests/Point-v0", weight=3.0)
    finally:
        del gym.registry["tests/Point-v0"]


@pytest.mark.parametrize("name", ["NoSuchEnv-v0", "nosuchmodule:Env-v0", "not an id"])
def test_an_unknown_id_is_answered_with_a_sentence(name: str) -> None:
    with pytest.raises(EnvError, match="Cannot make the env"):
        make_env(name)


@pytest.mark.slow
def test_envs_of_this_package_are_registered_by_an_import() -> None:
    code = "from mcpilco.agent import make_env; make_env('mcpilco/CartPoleSwingUp-v0')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "Write `import envs` first" in done.stderr


def test_what_is_no_single_env_is_refused() -> None:
    vector = gym.vector.SyncVectorEnv([PointEnv])
    with pytest.raises(EnvError, match="one gymnasium.Env .* got SyncVectorEnv"):
        make_env(vector)
    with pytest.raises(EnvError, match="got NoneType"):
        make_env(None)


def test_a_task_given_comes_before_the_one_shown() -> None:
    other = dataclasses.replace(TASK, dt=0.5)
    assert task_of(PointEnv(), other) is other


@pytest.mark.parametrize(
    ("env", "message"),
    [
        (with_spaces(action_space=Discrete(3)), "Box action space, got Discrete.*are real numbers"),
        (with_spaces(action_space=Box(0, 5, (1,), np.int64)), "got Box.*inputs are real numbers"),
        (with_spaces(observation_space=Box(0, 1, (8, 8, 3))), "images and tables are no state"),
        (with_spaces(action_space=Box(-1, 1, (1, 1))), "one-dimensional Box action space"),
        (with_spaces(action_space=Box(-1, 1, (2,))), r"1 actions, its action space has shape \(2"),
        (with_spaces(observation_space=Box(-1, 1, (3,))), "task names 2 observations"),
        (with_spaces(observation_space=Dict(x=Box(-1, 1, (2,)))), "got Dict.*; flatten it"),
    ],
)
def test_spaces_that_do_not_fit_are_answered_with_a_sentence(env: PointEnv, message: str) -> None:
    with pytest.raises(EnvError, match=f"The env PointEnv.*{message}"):
        task_of(env, None)


@pytest.mark.parametrize(
    ("task", "message"),
    [(None, "shows no attribute `task`"), (SimpleNamespace(dt=1.0), "of type SimpleNamespace")],
)
def test_an_env_without_a_task_is_told_to_show_one(task, message: str) -> None:
    env = PointEnv()
    env.task = task
    with pytest.raises(EnvError, match=f"{message}.*MCPILCO\\(..., task=...\\)"):
        task_of(env, None)


def test_bounds_are_the_spaces_in_float64() -> None:
    low, high = input_bounds(with_spaces(action_space=Box(-0.1, 0.3, (1,), np.float32)))
    assert low.dtype == high.dtype == np.float64
    np.testing.assert_array_equal([low, high], np.float32([[-0.1], [0.3]]))


@pytest.mark.parametrize(("low", "high"), [(-np.inf, 1.0), (-1.0, np.inf), (1.0, 1.0)])
def test_unbounded_inputs_are_answered_with_a_sentence(low: float, high: float) -> None:
    with pytest.raises(EnvError, match="finite action bounds.*TransformAction"):
        input_bounds(with_spaces(action_space=Box(low, high, (1,))))


def test_the_horizon_is_as_configured_within_the_time_limit() -> None:
    limited = gym.make(gym.envs.registration.EnvSpec("P-v0", PointEnv, max_episode_steps=9))
    assert [horizon_of(limited, steps) for steps in (None, 9, 4)] == [9, 9, 4]
    assert horizon_of(PointEnv(), 4) == 4
    with pytest.raises(InputError, match="time limit of 9 steps, got 10"):
        horizon_of(limited, 10)
    with pytest.raises(InputError, match="no time limit; pass a horizon"):
        horizon_of(TimeLimit(PointEnv(), 9), None)  # its limit is not in the spec


def test_an_absent_env_is_described_but_does_nothing() -> None:
    low, high = np.float32([-1.5]), np.float32([2.5])
    env = AbsentEnv(TASK, low, high, horizon=12)
    assert task_of(env, None) is TASK
    assert input_bounds(env) == (low, high)
    assert env.action_space.dtype == np.float32
    assert horizon_of(env, None) == 12
    with pytest.raises(EnvError, match="loaded without an env"):
        env.reset(seed=1)


def of_numpy(states, inputs):
    return np.asarray(states)[..., 0]


WRONG_COSTS = [
    (lambda states, inputs: states[..., 5], "raised IndexError.* of the 2 states in the last axis"),
    (of_numpy, "raised RuntimeError: .*numpy"),
    (lambda states, inputs: 0.5, "got 0.5. Write it with torch"),
    (lambda states, inputs: states[..., 0] > 0, "Write it with torch"),
    (
        lambda states, inputs: states[:, 0],
        r"tensor \(4, 5\); got shape \(4, 2\). .*last axis alone",
    ),
    (lambda states, inputs: states**2, r"got shape \(4, 5, 2\)"),
    (lambda states, inputs: (states**2).mean(), r"got shape \(\)"),
    (lambda states, inputs: torch.log(-(states[..., 0] ** 2)), "not finite where episodes start"),
    (lambda states, inputs: states[..., 0].detach(), "without gradient"),
    (lambda states, inputs: (0 * states[..., 0]).sqrt(), "gradient that is not finite"),
]


@pytest.mark.parametrize(("cost", "message"), WRONG_COSTS)
def test_a_cost_that_no_search_can_use_is_answered_with_a_sentence(cost, message: str) -> None:
    with pytest.raises(EnvError, match=message):
        check_cost(dataclasses.replace(TASK, cost=cost), np.array([-2.0]), np.array([2.0]))


def test_a_cost_of_the_inputs_alone_or_learned_from_rewards_is_fine() -> None:
    for cost in (None, lambda states, inputs: (inputs**2).sum(-1), TASK.cost):
        check_cost(dataclasses.replace(TASK, cost=cost), np.array([-2.0]), np.array([2.0]))


def test_an_absurd_horizon_is_refused_with_the_memory_it_would_take() -> None:
    """Before anything of that length is made; the limit itself is fine."""
    with pytest.raises(InputError, match="at most 100000 steps, got 100000000: .* [0-9.e+]+ GB"):
        horizon_of(PointEnv(), 10**8)
    assert horizon_of(PointEnv(), 100_000) == 100_000
    with pytest.raises(InputError, match="exploration must be .* at most 100000, got 100000000"):
        Config(exploration=10**8)
    with pytest.raises(InputError, match="fresh_horizon must be from 1 to 100000 steps"):
        Settings("tests/Point-v0", fresh_horizon=10**8)


def test_no_module_is_imported_for_an_id(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As Gymnasium would; who types a name imports its module first."""
    (tmp_path / "evil_of_a_file.py").write_text("raise SystemExit('executed')")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(EnvError, match="no module is imported .* `--trust evil_of_a_file`"):
        make_env("evil_of_a_file:X-v0")


@pytest.mark.parametrize("form", ["{}", ["{}"], {"of": "{}"}])
def test_no_module_is_imported_for_an_id_in_a_keyword(
    form: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As shimmy's envs would, which make another one of its id."""
    (tmp_path / "evil_of_a_file.py").write_text("raise SystemExit('executed')")
    monkeypatch.syspath_prepend(str(tmp_path))

    def wrapped(inner: object) -> gym.Env:
        (name,) = names_in(inner)
        return gym.make(name)

    monkeypatch.setitem(gym.registry, "Wrapped-v0", EnvSpec("Wrapped-v0", entry_point=wrapped))
    inner = json.loads(json.dumps(form).replace("{}", "evil_of_a_file:X-v0"))
    with pytest.raises(EnvError, match="no module is imported .* `--trust evil_of_a_file`"):
        make_env("Wrapped-v0", inner=inner)


def test_texts_that_name_no_module_are_keywords_as_any_other() -> None:
    texts = ["rgb_array", "12:30", "a b:c", "folder/model.xml", "http://page", ":", "x:"]
    assert not list(names_in({"keywords": texts}))
