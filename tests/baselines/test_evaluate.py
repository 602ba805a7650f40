"""One protocol for all agents."""

from __future__ import annotations

import numpy as np
import pytest

import envs  # noqa: F401  registers the cart-pole
from baselines.evaluate import Judge, learning_curve
from baselines.pilco import PILCO
from mcpilco import MCPILCO
from mcpilco.data import Spent
from mcpilco.typing import EnvError, InputError
from tests.baselines.pilco.models import TINY
from tests.mcpilco.sweep.strange import HERE
from tests.mcpilco.sweep.strange import TINY as PARTICLES

CART_POLE = "mcpilco/CartPoleSwingUp-v0"
POINT = f"{HERE}:Sweep/Point-v0"


class Constant:
    """Pushes always the same, and remembers nothing."""

    def __init__(self, force: float) -> None:
        self.force, self.num_timesteps = force, 0

    def predict(self, observation, state=None):
        return np.full((*observation.shape[:-1], 1), self.force), state

    def learn(self, total_timesteps):
        self.num_timesteps += total_timesteps


def test_equal_judges_put_everyone_before_the_same_episodes():
    found = []
    for _ in range(2):
        with Judge(CART_POLE, episodes=5, seed=3) as judge:
            first = judge(Constant(0.0))
            judge(Constant(5.0))
            again = judge(Constant(0.0))
        assert (first.outcomes["return"] == again.outcomes["return"]).all()
        found.append(first.outcomes["return"])
    assert (found[0] == found[1]).all()


def test_another_seed_is_another_set_of_episodes():
    returns = []
    for seed in (0, 1):
        with Judge(CART_POLE, episodes=3, seed=seed) as judge:
            returns.append(judge(Constant(0.0)).outcomes["return"])
    assert (returns[0] != returns[1]).all()


def test_a_judgement_tells_all_measures_as_json():
    with Judge(CART_POLE, {"start_std": 0.0, "noise_std": 0.0}, episodes=2) as judge:
        told = judge(Constant(0.0), 3.0, Spent(wall_s=2.0, cpu_s=1.5)).to_json()
    assert told.pop("return") == pytest.approx(30 * np.exp(-(np.pi**2)), rel=1e-6)
    assert told == {
        "experience_s": 3.0,
        "cpu_s": 1.5,
        "wall_s": 2.0,
        "episodes": 2,
        "is_success": 0.0,
        "time_up_s": 0.0,
        "mean_abs_cart_m": 0.0,
    }


def test_what_the_env_does_not_tell_is_none():
    with Judge(POINT, episodes=2, horizon=4) as judge:
        assert judge(Constant(0.0)).to_json()["is_success"] is None


def test_a_curve_counts_the_experience_of_agents_that_learn_from_every_step():
    with Judge(CART_POLE, episodes=1, horizon=2) as judge:
        found = list(learning_curve(Constant(1.0), judge, [30, 60]))
    assert [one.experience_s for one in found] == pytest.approx([3.0, 6.0])
    assert found[1].cpu_s >= found[0].cpu_s >= 0.0


@pytest.mark.parametrize(
    ("kind", "config"), [(MCPILCO, PARTICLES), (PILCO, TINY)], ids=["mcpilco", "pilco"]
)
def test_a_curve_counts_the_experience_of_a_policy_that_learns_by_trials(kind, config):
    """The rollout that tried it was not learned from yet."""
    agent = kind(kind.policy_name, POINT, config=config)
    amounts = [agent.timesteps_of(trials) for trials in (1, 2)]
    with Judge(POINT, episodes=2) as judge:
        found = list(learning_curve(agent, judge, amounts))
    expected = [(steps - agent.horizon) * agent.task.dt for steps in amounts]
    assert [one.experience_s for one in found] == pytest.approx(expected)


@pytest.mark.parametrize("amounts", [[30, 30], [60, 30]])
def test_amounts_that_do_not_rise_are_refused(amounts):
    with (
        Judge(CART_POLE, episodes=1) as judge,
        pytest.raises(InputError, match="amounts must rise"),
    ):
        list(learning_curve(Constant(0.0), judge, amounts))


def test_a_judge_without_episodes_is_refused():
    with pytest.raises(InputError, match="episodes must be at least 1"):
        Judge(CART_POLE, episodes=0)


def test_an_env_that_is_not_there_is_refused():
    with pytest.raises(EnvError, match="Cannot make the env"):
        Judge("mcpilco/NoSuchEnv-v0")
