"""Seeds of a sweep, and the fresh episodes that their policies are judged on."""

from __future__ import annotations

import dataclasses
import json

import gymnasium as gym
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import envs  # noqa: F401  registers the cart-pole
from mcpilco.agent import MCPILCO
from mcpilco.data import is_measure
from mcpilco.logbook import Callback
from mcpilco.sweep import job
from mcpilco.sweep.job import FreshEpisodes, Settings, batch_outcomes, run_seed
from mcpilco.typing import EnvError, InputError
from tests.mcpilco.sweep.strange import HERE, HORIZON, TINY, Short

SWINGS = Settings(
    "envs:mcpilco/CartPoleSwingUp-v0", {"max_episode_steps": 8}, config=TINY, trials=2, fresh=3
)
POINT = Settings(f"{HERE}:Sweep/Point-v0", config=TINY, trials=2, fresh=3)
CHANGING = ("cpu_s", "wall_s")


def rows(settings, seed, *but):
    trials = run_seed(settings, seed)["trials"]
    return [{k: v for k, v in row.items() if k not in (*CHANGING, *but)} for row in trials]


def test_a_seed_learns_what_the_agent_learns_from_it():
    """Judging the policies draws no number of the training's."""
    env = gym.make(SWINGS.env, **SWINGS.env_kwargs)
    agent = MCPILCO("SumOfGaussians", env, config=TINY, seed=5)
    with threadpool_limits(1):  # sums of several threads differ in their last digits
        agent.learn(3 * agent.horizon)
    found = run_seed(SWINGS, 5)["trials"]
    assert len(found) == len(agent.results) == 2
    for row, result in zip(found, agent.results, strict=True):
        assert row["success"] == result.success
        for key in ("experience_s", "predicted_cost", "real_cost", "starts"):
            assert row[key] == getattr(result, key)
        assert row["mean_abs_cart_m"] == result.outcome["mean_abs_cart_m"]


@pytest.mark.slow
def test_judging_changes_no_other_number():
    unjudged = dataclasses.replace(SWINGS, fresh=0)
    fresh = ("p", "fresh_return")
    assert rows(SWINGS, 0, *fresh) == rows(unjudged, 0, *fresh)
    assert all(row["p"] is None and row["fresh_return"] is None for row in rows(unjudged, 0))
    assert all(0 <= row["p"] <= 1 for row in rows(SWINGS, 0))


def test_judging_is_over_before_a_trials_clock_starts_and_begins_after_it_stops(monkeypatch):
    order = []

    class Note(Callback):
        def on_trial_start(self, trial):
            order.append("start")

    learn, judge = MCPILCO.learn, FreshEpisodes.outcomes
    monkeypatch.setattr(
        MCPILCO, "learn", lambda self, steps, callback: learn(self, steps, [Note(), callback])
    )
    monkeypatch.setattr(
        FreshEpisodes, "outcomes", lambda *given: (order.append("judge"), judge(*given))[1]
    )
    run_seed(SWINGS, 0)
    assert order == ["start", "judge", "start", "judge"]


@pytest.mark.slow
def test_equal_seeds_give_equal_results_and_others_do_not():
    assert rows(SWINGS, 1) == rows(SWINGS, 1)
    assert rows(SWINGS, 1) != rows(SWINGS, 2)


def test_a_result_is_json_and_names_machine_and_versions():
    result = run_seed(SWINGS, 3)
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    assert result["seed"] == 3
    assert result["machine"]["cpu"]
    assert {"python", "torch"} <= result["versions"].keys()


def test_an_env_that_tells_no_success_is_judged_by_its_return():
    for row in rows(POINT, 0):
        assert row["success"] is row["p"] is None
        assert not any(is_measure(name) for name in row)
        assert isinstance(row["return"], float)
        assert isinstance(row["fresh_return"], float)


def test_an_env_that_breaks_is_an_error():
    with pytest.raises(EnvError, match="must return finite numbers"):
        run_seed(dataclasses.replace(POINT, env=f"{HERE}:Sweep/Broken-v0"), 0)


@pytest.mark.parametrize("wrong", [{"trials": 0}, {"fresh": -1}])
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        Settings("Any-v0", **wrong)


CART_POLE = "mcpilco/CartPoleSwingUp-v0"


def swing(observations):
    """Pumps energy: pushes with the pole's motion."""
    return 10.0 * np.sign(observations[..., 3:4] * np.cos(observations[..., 2:3]))


def idle(observations):
    return np.zeros((*observations.shape[:-1], 1))


def outcomes(env, act, episodes=3, kwargs=None, seed=0, trial=1, horizon=HORIZON):
    with FreshEpisodes(env, kwargs or {}, episodes, horizon) as judge:
        return judge.outcomes(lambda: act, seed, trial)


def test_batch_agrees_with_single_envs_on_the_same_episodes():
    """Without noise, from the same state: no chance is left."""
    start = {"state": [0.1, 0.0, 3.1, 0.2]}
    kwargs = {"noise_std": 0.0}
    single = gym.make(CART_POLE, **kwargs)
    many = gym.make_vec(CART_POLE, 2, vectorization_mode="vector_entry_point", **kwargs)
    for env in (single, many):
        reset = env.reset
        env.reset = lambda *, seed, options=None, reset=reset: reset(seed=seed, options=start)
    one = job.outcomes_one_by_one(single, lambda: swing, 30, [1])
    batch = batch_outcomes(many, swing, 30, 1)
    assert one.keys() == batch.keys() == {"return", "is_success", "time_up_s", "mean_abs_cart_m"}
    for name, values in one.items():
        assert batch[name] == pytest.approx(np.repeat(values, 2), abs=1e-9)
    assert one["time_up_s"] > 0


def test_batch_and_single_envs_have_the_same_distribution(monkeypatch):
    batch = outcomes(CART_POLE, swing, 100, horizon=30)
    monkeypatch.setattr(job, "_vector_form", lambda *arguments: None)
    single = outcomes(CART_POLE, swing, 20, horizon=30)
    for name in ("return", "mean_abs_cart_m"):
        error = np.hypot(batch[name].std() / 100**0.5, single[name].std() / 20**0.5)
        assert abs(batch[name].mean() - single[name].mean()) < 4 * error


def test_episodes_repeat_with_seed_and_trial_alone():
    first, again = (outcomes(CART_POLE, swing)["return"] for _ in range(2))
    assert (first == again).all()
    assert len(np.unique(first)) == len(first)
    for other in ({"seed": 1}, {"trial": 2}):
        assert (outcomes(CART_POLE, swing, **other)["return"] != first).all()


@pytest.mark.parametrize("vector", [True, False])
def test_no_fresh_episode_has_the_seed_of_a_training(monkeypatch, vector):
    seeds = []
    name = "batch_outcomes" if vector else "outcomes_one_by_one"
    if not vector:
        monkeypatch.setattr(job, "_vector_form", lambda *arguments: None)
    monkeypatch.setattr(
        job, name, lambda env, act, horizon, seed, *_: {"seed": seeds.append(seed) or np.zeros(1)}
    )
    outcomes(CART_POLE, swing, 4, seed=7)
    assert np.min(seeds) >= 2**32


@pytest.mark.parametrize("env", ["Short", "Same", "AtOnce", "Other"])
def test_what_follows_the_end_of_an_episode_does_not_count(env):
    found = outcomes(f"{HERE}:Sweep/{env}-v0", idle)
    assert found["return"].tolist() == [2.0] * 3
    assert found["is_success"].tolist() == [1.0] * 3


@pytest.mark.parametrize(("env", "used"), [("Same", True), ("AtOnce", False), ("Other", False)])
def test_a_vector_form_is_used_where_it_is_the_same_env(env, used):
    with FreshEpisodes(f"{HERE}:Sweep/{env}-v0", {}, 3, HORIZON) as judge:
        assert (judge._vector is not None) == used


def test_actions_are_clipped_as_in_training():
    wild = outcomes(CART_POLE, lambda x: 1e9 * swing(x))
    assert (wild["return"] == outcomes(CART_POLE, swing)["return"]).all()


def test_an_env_that_tells_no_success_has_a_return_alone():
    assert outcomes(f"{HERE}:Sweep/Point-v0", idle).keys() == {"return"}


def test_values_that_are_not_finite_are_refused():
    with pytest.raises(EnvError, match="must return finite numbers"):
        outcomes(f"{HERE}:Sweep/Broken-v0", idle)


class Fragile(gym.Wrapper):
    """Breaks in the second step of its second episode; then it does not begin another one."""

    episodes = steps = 0

    def reset(self, **keywords):
        self.episodes, self.steps = self.episodes + 1, 0
        if self.episodes == 3:
            raise EnvError("No machine answers.")
        return super().reset(**keywords)

    def step(self, action):
        self.steps += 1
        if (self.episodes, self.steps) == (2, 2):
            raise EnvError("a sensor jumped")
        return super().step(action)


def test_an_episode_that_breaks_off_is_told_and_no_success_and_none_is_repeated(caplog):
    """What was kept before the system did not begin another one is no more asked of it."""
    kept = []
    with pytest.raises(EnvError, match="No machine answers"):
        job.outcomes_one_by_one(Fragile(Short()), lambda: idle, 5, [1, 2, 3], kept)
    assert [one["return"] for one in kept] == [2.0, 1.0]
    assert "a sensor jumped" in caplog.text
    found = job.outcomes_one_by_one(Short(), lambda: idle, 5, [1, 2, 3], kept)
    assert found["is_success"].tolist() == [1.0, 0.0, 1.0]
    assert len(kept) == 3
