"""What networks see, and what becomes of what they answer."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium import spaces
from stable_baselines3.common.env_checker import check_env

import envs  # noqa: F401  registers its ids
from baselines.sb3.library import View, ViewedEnv
from mcpilco.agent import input_bounds, make_env, task_of
from mcpilco.typing import EnvError
from tests.mcpilco.sweep.strange import Broken, Point


def viewed(env_id: str) -> ViewedEnv:
    env = make_env(env_id)
    return ViewedEnv(env, View(task_of(env, None), *input_bounds(env)))


@pytest.mark.parametrize("env_id", ["mcpilco/CartPoleSwingUp-v0", "mcpilco/Pendulum-v0"])
def test_stable_baselines3_is_content_with_the_view(env_id):
    check_env(viewed(env_id))


def test_features_are_plain_states_then_cosines_then_sines():
    view = viewed("mcpilco/CartPoleSwingUp-v0").view
    features = view.features(np.array([[1.0, 2.0, np.pi / 3, 4.0]]))
    np.testing.assert_allclose(features, [[1, 2, 4, 0.5, np.sqrt(0.75)]], rtol=1e-6)


def test_actions_and_inputs_are_each_others_inverse():
    view = View(Point.task, np.array([-1.0]), np.array([3.0]))
    actions = np.linspace(-1, 1, 5)[:, None]
    np.testing.assert_allclose(view.inputs(actions)[:, 0], [-1, 0, 1, 2, 3])
    np.testing.assert_allclose(view.actions(view.inputs(actions)), actions, atol=1e-6)


def test_the_env_is_pushed_with_its_own_unit():
    env = viewed("mcpilco/CartPoleSwingUp-v0")
    env.reset(seed=0, options={"state": np.zeros(4)})
    _, reward, *_ = env.step(np.array([1.0], dtype=np.float32))
    alone = make_env("mcpilco/CartPoleSwingUp-v0")
    alone.reset(seed=0, options={"state": np.zeros(4)})
    assert alone.step(np.array([10.0]))[1] == pytest.approx(reward)


def test_what_an_env_raises_is_an_error_of_the_env():
    class Raising(Point):
        def step(self, action):
            raise ZeroDivisionError("stuck")

    for kind, sentence in ((Raising, "ZeroDivisionError: stuck"), (Broken, "finite numbers")):
        env = kind()
        view = ViewedEnv(env, View(env.task, *input_bounds(env)))
        view.reset(seed=0)
        with pytest.raises(EnvError, match=sentence):
            view.step(np.zeros(1, np.float32))
    assert isinstance(view.action_space, spaces.Box)
