"""Every vector env is a loop of single envs."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from envs.swing_up_env import SwingUpVectorEnv
from mcpilco.typing import InputError
from tests.envs.systems import each_drawn_system, each_system

QUIET = {"start_std": 0.0, "noise_std": 0.0}


@each_system
def test_make_vec_gives_the_vector_env(system):
    batch = gym.make_vec(system.id, num_envs=3, noise_std=0.02)
    assert isinstance(batch.unwrapped, SwingUpVectorEnv)
    assert batch.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    assert batch.observation_space.shape == (3, system.width)
    assert batch.action_space.shape == (3, 1)
    assert batch.unwrapped.swing_up.noise_std == (0.02,) * system.width
    assert batch.unwrapped.task == gym.make(system.id).unwrapped.task


@each_system
def test_vector_env_is_a_loop_of_single_envs_through_resets(system):
    """Over two time limits, so that the automatic resets are compared too."""
    n, rng, steps = 4, np.random.default_rng(0), system.followed
    starts = np.array([system.state(*pair) for pair in rng.normal(size=(n, 2)) * [3.0, 1.0]])
    batch = system.batch(n, max_episode_steps=steps, **QUIET)
    loop = SyncVectorEnv([lambda: gym.make(system.id, max_episode_steps=steps, **QUIET)] * n)
    batch_return = batch.reset(seed=0, options={"state": starts})
    loop.reset(seed=0)
    firsts = [
        single.unwrapped.reset(options={"state": start})
        for single, start in zip(loop.envs, starts, strict=True)
    ]
    np.testing.assert_array_equal(batch_return[0], [observation for observation, _ in firsts])
    for step in range(2 * steps + 10):
        actions = (1.2 * system.limit * rng.uniform(-1, 1, (n, 1))).astype(np.float32)
        ours, theirs = batch.step(actions), loop.step(actions)
        for mine, yours in zip(ours[:4], theirs[:4], strict=True):
            assert mine.dtype == yours.dtype
            np.testing.assert_allclose(mine, yours, atol=1e-9, err_msg=f"step {step}")
        assert set(ours[4]) == set(theirs[4])
        for key, value in theirs[4].items():
            assert ours[4][key].dtype == value.dtype
            np.testing.assert_allclose(ours[4][key], value, atol=1e-9, err_msg=f"{key} at {step}")


@each_system
def test_episodes_that_end_at_different_times_restart_alone(system):
    batch = system.batch(2, max_episode_steps=5, **QUIET)
    batch.reset(options={"state": system.state(np.pi)})
    batch._steps[:] = [3, 0]
    action = np.zeros((2, 1))
    truncated = np.array([batch.step(action)[3] for _ in range(2)])
    assert truncated.tolist() == [[False, False], [True, False]]
    observations, rewards, _, truncated, infos = batch.step(action)
    assert rewards[0] == 0.0
    assert rewards[1] == pytest.approx(1.0)
    assert not truncated.any()
    np.testing.assert_array_equal(observations[0], np.zeros(system.width))
    assert infos["time_up_s"] == pytest.approx([0.0, 3 * batch.task.dt])


@each_system
def test_equal_seeds_give_equal_batches_of_different_episodes(system):
    def run(seed):
        batch = system.batch(3, max_episode_steps=system.followed)
        batch.action_space.seed(0)
        observations = [batch.reset(seed=seed)[0]]
        steps = range(system.followed + 5)
        observations += [batch.step(batch.action_space.sample())[0] for _ in steps]
        return np.array(observations)

    np.testing.assert_array_equal(run(1), run(1))
    assert (run(1) != run(2)).all()
    assert (run(1)[:, 0] != run(1)[:, 1]).all()


@each_system
def test_one_start_serves_all_or_each_has_its_own(system):
    batch = system.batch(2)
    state, other = (system.state(*pair).tolist() for pair in ((0.3, 0.4), (3.0, 4.0)))
    assert batch.reset(options={"state": state})[1]["state"].tolist() == [state, state]
    each = [state, other]
    assert batch.reset(options={"state": each})[1]["state"].tolist() == each


@each_system
def test_returned_arrays_are_the_callers_to_keep(system):
    batch = system.batch(2, **QUIET)
    observations, infos = batch.reset(seed=0)
    observations[:], infos["state"][:] = 9.0, 9.0
    assert np.abs(batch.step(np.zeros((2, 1)))[0]).max() < 1.0


@each_system
def test_no_limit_never_truncates(system):
    batch = system.batch(1, max_episode_steps=None)
    batch.reset(seed=0)
    assert not any(batch.step(np.zeros((1, 1)))[3].any() for _ in range(system.steps + 10))


@each_drawn_system
def test_pictures_are_those_of_the_single_env(system):
    states = [system.state(), system.state(2.0)]
    batch = system.batch(2, render_mode="rgb_array")
    batch.reset(options={"state": states})
    single = system.single(render_mode="rgb_array")
    for state, picture in zip(states, batch.render(), strict=True):
        single.reset(options={"state": state})
        np.testing.assert_array_equal(picture, single.render())


@each_system
@pytest.mark.parametrize(
    ("name", "value"),
    [("num_envs", 0), ("num_envs", 2.5), ("max_episode_steps", 0), ("dt", 0.0), ("start_std", -1)],
)
def test_wrong_keyword_value_is_refused_by_name(unchecked_shapes, system, name, value):
    with pytest.raises(InputError, match=name):
        system.batch(**{name: value})


@each_system
@pytest.mark.parametrize("actions", [np.zeros(2), np.zeros((3, 1)), np.array([[0.0], [np.nan]])])
def test_wrong_actions_are_refused(unchecked_shapes, system, actions):
    batch = system.batch(2)
    batch.reset(seed=0)
    with pytest.raises(InputError, match="action"):
        batch.step(actions)
