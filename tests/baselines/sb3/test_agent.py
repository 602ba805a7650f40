"""SAC, TQC and PPO as agents: they learn, remember, refuse, and are judged like others."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

import envs  # noqa: F401  registers the cart-pole
from baselines.evaluate import Judge, learning_curve
from baselines.sb3 import SACAgent, SACConfig, SB3Agent, make_learner
from mcpilco import MCPILCO
from mcpilco.logbook import Callback
from mcpilco.typing import EnvError, InputError, RunFolderError
from tests.baselines.sb3.small import TINY
from tests.mcpilco.point import STEPS, PointEnv
from tests.mcpilco.sweep.strange import HERE

CART_POLE = "mcpilco/CartPoleSwingUp-v0"
ALGOS = sorted(TINY)


def made(algo: str, env=CART_POLE, seed: int = 0) -> SB3Agent:
    return make_learner(algo, env, seed=seed, config=TINY[algo])


def numbers(agent: SB3Agent) -> dict[str, torch.Tensor]:
    return agent.learner.policy.state_dict()


def equal(one: SB3Agent, other: SB3Agent) -> bool:
    return all(map(torch.equal, numbers(one).values(), numbers(other).values()))


@pytest.mark.parametrize("algo", ALGOS)
def test_equal_seeds_learn_equally_and_others_do_not(algo):
    first, again, other = (made(algo, seed=seed).learn(24) for seed in (0, 0, 1))
    assert equal(first, again)
    assert not equal(first, other)


@pytest.mark.parametrize("algo", ALGOS)
def test_a_loaded_agent_goes_on_as_the_saved_one_would(algo, tmp_path):
    whole = made(algo).learn(24)
    half = made(algo).learn(12)
    loaded = type(half).load(half.save(tmp_path / "half.npz"), CART_POLE).learn(12)
    assert loaded.num_timesteps == whole.num_timesteps == 24
    assert loaded.trials == whole.trials == 2
    assert equal(whole, loaded)
    observation = np.array([0.1, 0.2, 3.0, 0.4])
    assert whole.predict(observation)[0] == loaded.predict(observation)[0]


def test_a_replay_buffer_that_is_full_is_saved_with_its_place(tmp_path):
    config = dataclasses.replace(TINY["sac"], buffer_size=10)
    agents = [make_learner("sac", CART_POLE, config=config) for _ in range(2)]
    whole, half = agents[0].learn(24), agents[1].learn(12)
    loaded = SACAgent.load(half.save(tmp_path / "half.npz"), CART_POLE).learn(12)
    memories = [agent.learner.replay_buffer for agent in (whole, loaded)]
    assert memories[0].full
    assert memories[0].pos == memories[1].pos
    np.testing.assert_array_equal(memories[0].rewards, memories[1].rewards)
    assert equal(whole, loaded)


@pytest.mark.parametrize("algo", ALGOS)
def test_an_agent_is_loaded_without_an_env_to_predict(algo, tmp_path):
    agent = made(algo).learn(12)
    alone = type(agent).load(agent.save(tmp_path / "agent.npz"))
    assert alone.predict(np.ones(4))[0] == agent.predict(np.ones(4))[0]
    with pytest.raises(EnvError, match="without an env"):
        alone.learn(12)


@pytest.mark.parametrize("algo", ALGOS)
def test_a_curve_judges_it_after_the_steps_that_it_has_taken(algo):
    agent = made(algo)
    with Judge(CART_POLE, episodes=2) as judge:
        found = list(learning_curve(agent, judge, [12, 36]))
    assert agent.num_timesteps == 36
    assert [one.experience_s for one in found] == pytest.approx([1.2, 3.6])


def test_ppo_rounds_up_to_its_updates():
    agent = made("ppo").learn(13)
    assert agent.num_timesteps == 24


def test_learning_leaves_the_random_numbers_of_others_alone():
    def drawn(disturbed: bool) -> tuple[float, float]:
        np.random.seed(1)  # noqa: NPY002
        torch.manual_seed(1)
        if disturbed:
            made("sac").learn(12)
        return np.random.random(), torch.rand(1).item()  # noqa: NPY002

    assert drawn(disturbed=True) == drawn(disturbed=False)


def test_a_batch_of_observations_is_answered_as_each_alone_within_bounds():
    agent = made("sac").learn(12)
    batch = np.random.default_rng(0).normal(0.0, 3.0, (5, 4))
    actions, _ = agent.predict(batch)
    alone = np.stack([agent.predict(row)[0] for row in batch])
    np.testing.assert_allclose(actions, alone, rtol=1e-5)
    assert (np.abs(actions) <= 10.0).all()


def test_full_turns_look_alike():
    agent = made("sac").learn(12)
    actions, _ = agent.predict(np.array([[0.1, 0.2, 0.3, 0.4], [0.1, 0.2, 0.3 + 4 * np.pi, 0.4]]))
    np.testing.assert_allclose(actions[0], actions[1], rtol=1e-5)


def test_trials_are_tried_and_told_in_order():
    told: list[str] = []

    class Ear(Callback):
        def on_trial_start(self, trial):
            told.append(f"start {trial}")

        def on_policy_step(self, step, steps, values):
            told.append(f"episode {step}/{steps}")
            assert values["policy/cost"] + values["rollout/ep_return"] == pytest.approx(6)

        def on_trial_end(self, result):
            told.append(f"end {result.trial} {result.experience_s:g} s")

    agent = made("sac").learn(24, callback=Ear())
    first = ["start 1", "episode 6/12", "episode 12/12", "end 1 1.2 s"]
    assert told == [*first, "start 2", "episode 6/12", "episode 12/12", "end 2 2.4 s"]
    assert [len(result.rollout) for result in agent.results] == [6, 6]


def test_the_real_cost_is_that_of_the_task():
    result = made("sac").learn(12).results[0]
    noise_free = 6 - result.rollout.rewards.sum()
    assert result.real_cost == pytest.approx(noise_free, rel=1e-6)


@pytest.mark.slow
def test_sac_learns_to_move_a_point():
    """The cost is least at 1 m: an idle policy would pay 6 (1 - 1/e)."""
    config = SACConfig(
        learning_starts=60,
        gamma=0.9,
        learning_rate=3e-3,
        batch_size=64,
        ent_coef=0.01,
        horizon=STEPS,
    )
    agent = SACAgent("MlpPolicy", PointEnv(), config=config).learn(600)
    assert agent.results[-1].real_cost < 0.8 * STEPS * (1 - np.exp(-1))


def test_a_file_is_loaded_by_the_class_of_its_algorithm_only(tmp_path):
    path = made("sac").learn(12).save(tmp_path / "sac.npz")
    with pytest.raises(RunFolderError, match="algorithm 'sac', expected one of 'mcpilco'"):
        MCPILCO.load(path, CART_POLE)
    with pytest.raises(RunFolderError, match="algorithm 'sac', expected one of 'tqc'"):
        type(made("tqc")).load(path, CART_POLE)


@pytest.mark.parametrize("change", ["nan", "shape", "missing"])
def test_a_damaged_file_is_refused(tmp_path, change):
    from mcpilco.files import read_arrays, write_arrays

    path = made("sac").learn(12).save(tmp_path / "sac.npz")
    arrays = read_arrays(path)
    name = "policy/actor.mu.weight"
    if change == "nan":
        arrays[name] = np.full_like(arrays[name], np.nan)
    elif change == "shape":
        arrays[name] = arrays[name][:, :-1]
    else:
        del arrays[name]
    write_arrays(path, arrays)
    with pytest.raises(RunFolderError, match="is damaged"):
        SACAgent.load(path, CART_POLE)


def test_a_file_of_another_system_is_refused(tmp_path):
    path = made("sac").learn(12).save(tmp_path / "sac.npz")
    with pytest.raises(RunFolderError, match="state_names"):
        SACAgent.load(path, "mcpilco/Pendulum-v0")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"algo": "dqn"}, "algo must be one of"),
        ({"preset": "tip"}, "preset must be one of"),
        ({"seed": -1}, "seed must be an integer of at least 0"),
        ({"env": "mcpilco/CartPoleSwingUpPositions-v0"}, "states are measured"),
    ],
)
def test_wrong_arguments_are_refused(arguments, sentence):
    with pytest.raises(InputError, match=sentence):
        make_learner(**{"algo": "sac", "env": CART_POLE, **arguments})


def test_learning_needs_a_step():
    with pytest.raises(InputError, match="at least 1 timestep"):
        made("sac").learn(0)


def test_copies_need_an_env_that_says_how_it_is_made():
    with pytest.raises(InputError, match="n_envs = 2 needs copies"):
        make_learner("ppo", PointEnv(), config=TINY["ppo"])


def test_an_env_that_breaks_is_blamed():
    config = dataclasses.replace(TINY["sac"], horizon=5)
    agent = make_learner("sac", f"{HERE}:Sweep/Broken-v0", config=config)
    with pytest.raises(EnvError, match="finite numbers"):
        agent.learn(12)


def test_a_file_holds_no_pickled_object(tmp_path: Path):
    path = made("sac").learn(12).save(tmp_path / "sac.npz")
    with np.load(path, allow_pickle=False) as arrays:
        assert all(arrays[name].dtype.kind in "fiuU" for name in arrays.files)
