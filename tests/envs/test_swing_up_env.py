"""Laws of every env, one at a time."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from mcpilco.typing import InputError
from tests.envs.systems import each_drawn_system, each_system
from tests.reference import REFERENCES


@pytest.fixture
def strict():
    """Turns warnings into errors, but for those about the action space: its limits are physical."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*symmetric and normalized")
        yield


@each_drawn_system
def test_gymnasium_checker_is_content(strict, system):
    check_env(gym.make(system.id, render_mode="rgb_array").unwrapped)


@each_drawn_system
def test_stable_baselines3_checker_is_content(strict, system):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gym.make(system.id, render_mode="rgb_array"))


@each_system
def test_step_is_the_motion_under_a_constant_input(system):
    env = system.single()
    _, info = env.reset(seed=0)
    held = system.action(0.4)
    expected = REFERENCES[system.id].advance(info["state"], np.float64(held[0]), env.task.dt)[-1]
    np.testing.assert_allclose(env.step(held)[4]["state"], expected, rtol=0, atol=1e-7)


@each_system
def test_reward_is_1_minus_cost_of_the_true_state_and_the_input_held(system):
    env = system.single()
    env.reset(seed=1)
    for share in (0.33, -1.0, 5.0):
        _, reward, *_, info = env.step(system.action(share))
        held = torch.tensor(system.action(min(share, 1.0)), dtype=torch.float64)
        assert reward == 1.0 - env.task.cost(torch.tensor(info["state"]), held).item()


@each_system
def test_reward_is_1_upright_and_less_than_a_tenth_of_it_hanging(system):
    def reward(angle):
        env = system.single()
        env.reset(options={"state": system.state(angle)})
        return env.step(system.action())[1]

    assert reward(np.pi) == pytest.approx(1.0, abs=1e-9)
    assert reward(-np.pi) == pytest.approx(1.0, abs=1e-9)
    assert 0.0 <= reward(0.0) < 0.1


@each_system
def test_equal_seeds_give_equal_episodes_and_others_differ(system):
    def episode(seed):
        env = system.single()
        observations = [env.reset(seed=seed)[0]]
        shares = [(k % 7 - 3) / 10 for k in range(10)]
        return np.array(observations + [env.step(system.action(share))[0] for share in shares])

    np.testing.assert_array_equal(episode(5), episode(5))
    assert (episode(5) != episode(6)).all()


@each_system
def test_reset_option_sets_the_true_state_exactly(system):
    env, state = system.single(), system.state(3.0, 4.0)
    observation, info = env.reset(seed=0, options={"state": state})
    assert info["state"].tolist() == state.tolist()
    assert (observation != state).all()


@each_system
def test_info_is_the_callers_to_keep(system):
    env = system.single()
    _, info = env.reset(seed=0)
    kept = info["state"].copy()
    info["state"][:] = 99.0
    assert env.step(system.action())[4]["state"][0] != pytest.approx(99.0, abs=50)
    assert np.abs(kept).max() < 1


@each_system
@pytest.mark.parametrize("std", [0.03, [0.01, 0.02, 0.03, 0.04]], ids=["one", "each"])
def test_measurement_noise_is_white_with_its_standard_deviation(system, std):
    std = std if isinstance(std, float) else std[: system.width]
    env = system.single(noise_std=std)
    noise = []
    for k in range(2000):
        observation, info = env.reset(seed=k if k == 0 else None)
        noise.append(observation - info["state"])
    noise = np.array(noise) / np.broadcast_to(std, system.width)
    # mean and variance of 2000 standard normal numbers, within 4.5 standard errors
    assert np.abs(noise.mean(axis=0)).max() < 4.5 / np.sqrt(2000)
    assert np.abs(noise.var(axis=0) - 1).max() < 4.5 * np.sqrt(2 / 2000)
    assert np.abs(np.corrcoef(noise.T) - np.eye(system.width)).max() < 4.5 / np.sqrt(2000)


@each_system
def test_noise_is_in_the_observation_of_a_step_too(system):
    quiet, noisy = system.single(noise_std=0.0), system.single(noise_std=0.01)
    for env in (quiet, noisy):
        env.reset(seed=0)
    observation, *_, info = quiet.step(system.action(0.1))
    np.testing.assert_array_equal(observation, info["state"])
    observation, *_, info = noisy.step(system.action(0.1))
    assert 0 < np.abs(observation - info["state"]).max() < 0.06


@each_system
def test_starts_have_their_mean_and_standard_deviation(system):
    std = np.array([0.1, 0.0, 0.2, 0.3])[: system.width]
    env = system.single(start_std=std)
    starts = np.array([env.reset(seed=None if k else 0)[1]["state"] for k in range(2000)])
    assert (np.abs(starts.mean(axis=0)) <= 4.5 * std / np.sqrt(2000)).all()
    np.testing.assert_allclose(starts.std(axis=0), std, rtol=4.5 / np.sqrt(4000))


@each_system
def test_input_beyond_the_limit_is_clipped(system):
    ends = []
    for share in (1.0, 2.5, np.inf):
        env = system.single()
        env.reset(options={"state": system.state()})
        ends.append(env.step(system.action(share))[4]["state"])
    # the first is rounded to float32, which the limit is not
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-6)
    np.testing.assert_array_equal(ends[1], ends[2])


@each_system
@pytest.mark.parametrize("action", [[np.nan], [1.0, 2.0], 1.0, [[1.0]]])
def test_wrong_action_is_refused_and_changes_nothing(unchecked_shapes, system, action):
    env = system.single()
    _, info = env.reset(seed=0)
    with pytest.raises(InputError, match="action"):
        env.step(np.array(action))
    np.testing.assert_array_equal(env._info()["state"], info["state"])


@each_system
def test_wrong_reset_option_is_refused(system):
    right = system.state()
    wrong = [{"state": value} for value in ([0, 0, 0], right + np.nan, right[:-1], "up")]
    for options in (*wrong, {"position": right}):
        with pytest.raises(InputError, match="state"):
            system.single().reset(options=options)


@each_system
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("gravity", float("nan")),
        ("dt", -0.1),
        ("dt", "fast"),
        ("start_std", -0.1),
        ("start_std", [0.1, 0.1, 0.1]),
        ("noise_std", float("inf")),
        ("noise_std", "none"),
        ("cost", 3.0),
        ("render_mode", "human"),
    ],
)
def test_wrong_keyword_value_is_refused_by_name(unchecked_shapes, system, name, value):
    with pytest.raises(InputError, match=name) as error:
        system.single(**{name: value})
    assert str(error.value).endswith(".")


@each_system
def test_episode_is_truncated_at_its_end_and_never_terminates(system):
    env = gym.make(system.id)
    env.reset(seed=0)
    ends = [env.step(system.action(0.1))[2:4] for _ in range(system.steps)]
    assert ends == [(False, False)] * (system.steps - 1) + [(False, True)]


@each_system
@pytest.mark.parametrize("upright", [np.pi, -np.pi])
def test_balanced_pole_is_a_success_after_exactly_1_s(system, upright):
    # at rest upright and without an input the pole stays up for longer than the episode
    env = system.single()
    _, info = env.reset(options={"state": system.state(upright)})
    assert (info["is_success"], info["time_up_s"]) == (False, 0.0)
    dt = env.swing_up.dt
    for step in range(1, round(1.5 / dt) + 1):
        *_, info = env.step(system.action())
        assert info["is_success"] is (step >= round(1.0 / dt))
        assert info["time_up_s"] == pytest.approx(dt * step)
    env.reset(options={"state": system.state()})
    assert env.step(system.action())[4]["time_up_s"] == 0.0


@each_system
def test_pole_that_swings_through_upright_is_seen_between_the_steps(system):
    # 12 rad/s: 20 degrees take 0.03 s, less than a step of 0.1 s
    env = system.single()
    env.reset(options={"state": system.state(np.pi - 0.5, 12.0)})
    *_, info = env.step(system.action())
    assert 0.02 <= info["time_up_s"] <= 0.04
    assert not info["is_success"]


@each_system
def test_sampling_time_is_free(system):
    env = system.single(dt=0.025)
    assert env.metadata["render_fps"] == 40
    env.reset(options={"state": system.state(np.pi)})
    infos = [env.step(system.action())[4] for _ in range(40)]
    assert [info["is_success"] for info in infos] == [False] * 39 + [True]
    assert infos[-1]["time_up_s"] == pytest.approx(1.0)


@each_drawn_system
def test_picture_follows_the_state(system):
    env = system.single(render_mode="rgb_array")
    env.reset(options={"state": system.state()})
    before = env.render()
    env.step(system.action(1.0))
    after = env.render()
    assert before.shape == after.shape == (352, 640, 3)
    assert before.dtype == np.uint8
    assert (before != after).any()


@each_system
def test_env_without_render_mode_draws_nothing_and_says_so(system):
    env = system.single()
    env.reset()
    with pytest.warns(UserWarning, match="rgb_array"):
        assert env.render() is None


@each_system
def test_env_must_be_reset_before_it_is_used(system):
    with pytest.raises(ResetNeeded):
        system.single().step(system.action())
