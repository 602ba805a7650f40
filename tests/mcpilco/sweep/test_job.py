from __future__ import annotations

import dataclasses
import json

import gymnasium as gym
import pytest
from threadpoolctl import threadpool_limits

from mcpilco.agent import MCPILCO
from mcpilco.data import is_measure
from mcpilco.logbook import Callback
from mcpilco.sweep.fresh import FreshEpisodes
from mcpilco.sweep.job import Settings, run_seed
from mcpilco.typing import EnvError, InputError
from tests.mcpilco.sweep.strange import HERE, TINY

CART_POLE = Settings(
    "envs:mcpilco/CartPoleSwingUp-v0", {"max_episode_steps": 8}, config=TINY, trials=2, fresh=3
)
POINT = Settings(f"{HERE}:Sweep/Point-v0", config=TINY, trials=2, fresh=3)
CHANGING = ("cpu_s", "wall_s")


def rows(settings, seed, *but):
    trials = run_seed(settings, seed)["trials"]
    return [{k: v for k, v in row.items() if k not in (*CHANGING, *but)} for row in trials]


def test_a_seed_learns_what_the_agent_learns_from_it():
    """Judging the policies draws no number of the training's."""
    env = gym.make(CART_POLE.env, **CART_POLE.env_kwargs)
    agent = MCPILCO("SumOfGaussians", env, config=TINY, seed=5)
    with threadpool_limits(1):  # sums of several threads differ in their last digits
        agent.learn(3 * agent.horizon)
    found = run_seed(CART_POLE, 5)["trials"]
    assert len(found) == len(agent.results) == 2
    for row, result in zip(found, agent.results, strict=True):
        assert row["success"] == result.success
        for key in ("experience_s", "predicted_cost", "real_cost", "starts"):
            assert row[key] == getattr(result, key)
        assert row["mean_abs_cart_m"] == result.outcome["mean_abs_cart_m"]


def test_judging_changes_no_other_number():
    unjudged = dataclasses.replace(CART_POLE, fresh=0)
    fresh = ("p", "fresh_return")
    assert rows(CART_POLE, 0, *fresh) == rows(unjudged, 0, *fresh)
    assert all(row["p"] is None and row["fresh_return"] is None for row in rows(unjudged, 0))
    assert all(0 <= row["p"] <= 1 for row in rows(CART_POLE, 0))


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
    run_seed(CART_POLE, 0)
    assert order == ["start", "judge", "start", "judge"]


def test_equal_seeds_give_equal_results_and_others_do_not():
    assert rows(CART_POLE, 1) == rows(CART_POLE, 1)
    assert rows(CART_POLE, 1) != rows(CART_POLE, 2)


def test_a_result_is_json_and_names_machine_and_versions():
    result = run_seed(CART_POLE, 3)
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
