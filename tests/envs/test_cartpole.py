"""Laws of the cart-pole env."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import envs
from mcpilco.costs import QuadraticCost, SaturatingCost, cart_pole_cost
from mcpilco.typing import InputError

ID = "mcpilco/CartPoleSwingUp-v0"


def make(**options) -> envs.CartPoleSwingUpEnv:
    return envs.CartPoleSwingUpEnv(**options)


def force(newton: float) -> np.ndarray:
    return np.array([newton], dtype=np.float32)


@pytest.fixture
def strict():
    """Turns warnings into errors, but for those about the action space: its limits are newtons."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized")
        yield


def test_gymnasium_checker_is_content(strict):
    check_env(gym.make(ID, render_mode="rgb_array").unwrapped)


def test_stable_baselines3_checker_is_content(strict):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gym.make(ID, render_mode="rgb_array"))


def test_defaults_are_those_of_pilco():
    env = gym.make(ID).unwrapped
    dynamics = env.swing_up.dynamics
    assert (dynamics.cart_mass, dynamics.pole_mass, dynamics.pole_length) == (0.5, 0.5, 0.5)
    assert (dynamics.cart_friction, dynamics.gravity) == (0.1, 9.82)
    assert env.task.start_std == (0.1,) * 4
    assert env.swing_up.noise_std == (0.01,) * 4
    assert env.task.dt == 0.1
    assert env.task.cost == cart_pole_cost()
    assert (env.action_space.low, env.action_space.high) == (-10.0, 10.0)
    assert env.action_space.dtype == np.float32


def test_task_names_the_state():
    task = make(start_std=[0.1, 0.2, 0.3, 0.4]).task
    assert task.state_names == ("cart_position", "cart_velocity", "pole_angle", "pole_velocity")
    assert task.state_units == ("m", "m/s", "rad", "rad/s")
    assert (task.input_names, task.input_units) == (("force",), ("N",))
    assert (task.angles, task.velocities) == ((2,), ((0, 1), (2, 3)))
    assert task.start_mean == (0.0,) * 4
    assert task.start_std == (0.1, 0.2, 0.3, 0.4)


def test_every_constant_changes_the_motion():
    def end(**options):
        env = make(**options)
        env.reset(options={"state": [0.0, 1.0, 1.0, 0.0]})
        return env.step(force(3.0))[4]["state"]

    changes = {
        "cart_mass": 0.6,
        "pole_mass": 0.6,
        "pole_length": 0.6,
        "cart_friction": 0.2,
        "gravity": 9.0,
        "dt": 0.05,
        "force_limit": 2.0,
    }
    for name, value in changes.items():
        assert np.abs(end(**{name: value}) - end()).max() > 1e-4, name


def test_step_is_the_motion_under_a_constant_force():
    env = make()
    _, info = env.reset(seed=0)
    expected = envs.CartPoleDynamics().advance(info["state"], np.float64(4.0), 0.1)[-1]
    np.testing.assert_allclose(env.step(force(4.0))[4]["state"], expected, rtol=0, atol=1e-12)


def test_equal_seeds_give_equal_episodes_and_others_differ():
    def episode(seed):
        env = make()
        observations = [env.reset(seed=seed)[0]]
        return np.array(observations + [env.step(force(k % 7 - 3))[0] for k in range(10)])

    np.testing.assert_array_equal(episode(5), episode(5))
    assert (episode(5) != episode(6)).all()


def test_reset_option_sets_the_true_state_exactly():
    env, state = make(), [0.1, -0.2, 3.0, 4.0]
    observation, info = env.reset(seed=0, options={"state": state})
    assert info["state"].tolist() == state
    assert (observation != state).all()


def test_info_is_the_callers_to_keep():
    env = make()
    _, info = env.reset(seed=0)
    kept = info["state"].copy()
    info["state"][:] = 99.0
    assert env.step(force(0.0))[4]["state"][0] != pytest.approx(99.0, abs=50)
    assert np.abs(kept).max() < 1


@pytest.mark.parametrize(
    ("cost", "width"),
    [
        (None, None),
        (None, (1.0, 3.0)),
        (QuadraticCost((0.0, 0.0, 3.0, 0.0), (1.0, 0.1, 2.0, 0.0), (0.05,)), None),
    ],
    ids=["default", "lengthscales", "quadratic"],
)
def test_reward_is_1_minus_cost_of_the_true_state_and_the_force_held(cost, width):
    options = {} if width is None else {"cost_lengthscales": width}
    env = make(cost=cost, **options)
    judged = cost or cart_pole_cost(*(width or (1.5, 1.0)))
    env.reset(seed=1)
    for newton in (3.3, -10.0, 50.0):
        action = force(newton)
        _, reward, *_, info = env.step(action)
        held = torch.tensor(np.clip(action, -10, 10), dtype=torch.float64)
        assert reward == 1.0 - judged(torch.tensor(info["state"]), held).item()


def test_default_cost_is_the_thesis_cost():
    assert make(cost_lengthscales=[1.0, 3.0]).task.cost == cart_pole_cost(1.0, 3.0)
    assert isinstance(make().task.cost, SaturatingCost)


@pytest.mark.parametrize("std", [0.03, [0.01, 0.02, 0.03, 0.04]])
def test_measurement_noise_is_white_with_its_standard_deviation(std):
    env = make(noise_std=std)
    noise = []
    for k in range(2000):
        observation, info = env.reset(seed=k if k == 0 else None)
        noise.append(observation - info["state"])
    noise = np.array(noise) / np.broadcast_to(std, 4)
    # mean and variance of 2000 standard normal numbers, within 4.5 standard errors
    assert np.abs(noise.mean(axis=0)).max() < 4.5 / np.sqrt(2000)
    assert np.abs(noise.var(axis=0) - 1).max() < 4.5 * np.sqrt(2 / 2000)
    assert np.abs(np.corrcoef(noise.T) - np.eye(4)).max() < 4.5 / np.sqrt(2000)


def test_noise_is_in_the_observation_of_a_step_too():
    quiet, noisy = make(noise_std=0.0), make(noise_std=0.01)
    for env in (quiet, noisy):
        env.reset(seed=0)
    observation, *_, info = quiet.step(force(1.0))
    np.testing.assert_array_equal(observation, info["state"])
    observation, *_, info = noisy.step(force(1.0))
    assert 0 < np.abs(observation - info["state"]).max() < 0.06


def test_starts_have_their_mean_and_standard_deviation():
    std = np.array([0.1, 0.2, 0.3, 0.0])
    env = make(start_std=std)
    starts = np.array([env.reset(seed=None if k else 0)[1]["state"] for k in range(2000)])
    assert (np.abs(starts.mean(axis=0)) <= 4.5 * std / np.sqrt(2000)).all()
    np.testing.assert_allclose(starts.std(axis=0), std, rtol=4.5 / np.sqrt(4000))


def test_force_beyond_the_limit_is_clipped():
    ends = []
    for newton in (10.0, 25.0, np.inf):
        env = make()
        env.reset(options={"state": [0, 0, 0, 0]})
        ends.append(env.step(force(newton))[4]["state"])
    np.testing.assert_array_equal(ends[0], ends[1])
    np.testing.assert_array_equal(ends[0], ends[2])


@pytest.mark.parametrize("action", [[np.nan], [1.0, 2.0], 1.0, [[1.0]]])
def test_wrong_action_is_refused_and_changes_nothing(unchecked_shapes, action):
    env = make()
    _, info = env.reset(seed=0)
    with pytest.raises(InputError, match="action"):
        env.step(np.array(action))
    np.testing.assert_array_equal(env._info()["state"], info["state"])


@pytest.mark.parametrize(
    "options",
    [{"state": [0, 0, 0]}, {"state": [0, 0, np.nan, 0]}, {"state": "up"}, {"position": [0] * 4}],
)
def test_wrong_reset_option_is_refused(options):
    with pytest.raises(InputError, match="state"):
        make().reset(options=options)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cart_mass", 0.0),
        ("pole_mass", None),
        ("pole_length", -0.5),
        ("cart_friction", -1.0),
        ("gravity", float("nan")),
        ("force_limit", 0.0),
        ("dt", -0.1),
        ("dt", "fast"),
        ("start_std", -0.1),
        ("start_std", [0.1, 0.1]),
        ("noise_std", float("inf")),
        ("noise_std", "none"),
        ("cost", 3.0),
        ("cost_lengthscales", (1.0,)),
        ("cost_lengthscales", (1.0, 0.0)),
        ("render_mode", "human"),
    ],
)
def test_wrong_keyword_value_is_refused_by_name(unchecked_shapes, name, value):
    with pytest.raises(InputError, match=name) as error:
        make(**{name: value})
    assert str(error.value).endswith(".")


def test_cost_and_lengthscales_exclude_each_other():
    with pytest.raises(InputError, match="not both"):
        make(cost=cart_pole_cost(), cost_lengthscales=(1.0, 1.0))


def test_episode_is_truncated_after_3_s_and_never_terminates():
    env = gym.make(ID)
    env.reset(seed=0)
    ends = [env.step(force(10.0))[2:4] for _ in range(30)]
    assert ends == [(False, False)] * 29 + [(False, True)]


def test_balanced_pole_is_a_success_after_exactly_1_s():
    # at rest upright and without force the pole stays up for longer than the episode
    env = make()
    _, info = env.reset(options={"state": [0.5, 0, -np.pi, 0]})
    assert (info["is_success"], info["time_up_s"], info["mean_abs_cart_m"]) == (False, 0.0, 0.0)
    for step in range(1, 16):
        *_, info = env.step(force(0.0))
        assert info["is_success"] is (step >= 10)
        assert info["time_up_s"] == pytest.approx(0.1 * step)
        assert info["mean_abs_cart_m"] == pytest.approx(0.5, abs=1e-3)
    env.reset(options={"state": [0, 0, 0, 0]})
    assert env.step(force(0.0))[4]["time_up_s"] == 0.0


def test_pole_that_swings_through_upright_is_seen_between_the_steps():
    # 12 rad/s: 20 degrees take 0.03 s, less than a step of 0.1 s
    env = make()
    env.reset(options={"state": [0, 0, np.pi - 0.5, 12.0]})
    *_, info = env.step(force(0.0))
    assert 0.02 <= info["time_up_s"] <= 0.04
    assert not info["is_success"]


def test_sampling_time_is_free():
    env = make(dt=0.025)
    assert env.metadata["render_fps"] == 40
    env.reset(options={"state": [0, 0, np.pi, 0]})
    infos = [env.step(force(0.0))[4] for _ in range(40)]
    assert [info["is_success"] for info in infos] == [False] * 39 + [True]
    assert infos[-1]["time_up_s"] == pytest.approx(1.0)


def test_picture_follows_the_state():
    env = make(render_mode="rgb_array")
    env.reset(options={"state": [0, 0, 0, 0]})
    before = env.render()
    env.step(force(10.0))
    after = env.render()
    assert before.shape == after.shape == (352, 640, 3)
    assert before.dtype == np.uint8
    assert (before != after).any()


def test_env_without_render_mode_draws_nothing_and_says_so():
    env = make()
    env.reset()
    with pytest.warns(UserWarning, match="rgb_array"):
        assert env.render() is None


def test_env_must_be_reset_before_it_is_used():
    with pytest.raises(ResetNeeded):
        make().step(force(0.0))
