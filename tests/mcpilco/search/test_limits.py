"""Laws of limits: where they are, how a search keeps them, and what is not tried."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch

from mcpilco.agent.agent import MCPILCO
from mcpilco.cli.options import limits as read_limits
from mcpilco.config import Config, Limit, ModelConfig, Phase, SearchConfig, from_dict
from mcpilco.search.limits import EXPLORED, Lagrangian, Limits
from mcpilco.search.search import PolicySearch
from mcpilco.typing import InputError
from tests.mcpilco.point import STEPS, TASK, TINY, PointEnv
from tests.mcpilco.search.test_search import line_policy, line_problem

RAIL = Limit("position", -0.5, 1.0)


def limits(*given: Limit, share: float = 0.9) -> Limits:
    found = Limits.of(given, share, TASK)
    assert found is not None
    return found


def at(*positions: float) -> torch.Tensor:
    return torch.tensor([[x, 7.0] for x in positions], dtype=torch.float64)


def test_beyond_is_nought_at_a_limit_and_minus_one_at_the_start() -> None:
    found = limits(RAIL).beyond(at(-1.0, -0.5, -0.25, 0.0, 0.5, 1.0, 2.0))
    np.testing.assert_allclose(found, [1.0, 0.0, -0.5, -1.0, -0.5, 0.0, 1.0])


def test_a_bound_may_be_missing_and_the_nearest_of_several_counts() -> None:
    one = limits(Limit("position", high=1.0))
    np.testing.assert_allclose(one.beyond(at(-9.0, 0.5)), [-10.0, -0.5])
    both = limits(RAIL, Limit("velocity", high=3.5))
    np.testing.assert_allclose(both.beyond(at(0.0)), [1.0])
    assert Limits.of((), 0.9, TASK) is None


def test_a_particle_keeps_the_limits_where_it_is_within_at_every_step() -> None:
    states = torch.stack([at(0.0, 0.0, 0.0, 0.0), at(0.0, 2.0, 0.9, -0.4), at(0.0, 0.0, 0.0, 0.0)])
    assert limits(RAIL).kept(states) == 0.75


def value(lagrangian: Lagrangian, states: torch.Tensor, cost: float = 1.0, progress: float = 1.0):
    return lagrangian.of(states, torch.full(states.shape[:2], cost).double(), progress)


def test_weights_ascend_where_too_many_are_outside_and_there_alone() -> None:
    weights = Lagrangian(limits(RAIL), 1.0, 2)
    states = torch.stack([at(0.0, 0.0), at(1.5, 1.5)])
    values = [float(value(weights, states)) for _ in range(20)]
    assert (np.diff(values) > 0).all()
    inside = torch.stack([at(1.5, 1.5), at(0.0, 0.0)])
    later = Lagrangian(limits(RAIL), 1.0, 2)
    for _ in range(20):
        value(later, states)
    assert float(value(later, inside)) < values[0] + 1e-12


def test_weights_rest_early_in_a_search() -> None:
    weights, states = Lagrangian(limits(RAIL), 1.0, 1), at(1.5, 1.5)[None]
    assert value(weights, states, progress=0.1) == value(weights, states, progress=0.1)


def test_the_objective_leads_back_inside() -> None:
    states = at(0.95, -0.6, 0.0)[None].requires_grad_()
    [slope] = torch.autograd.grad(value(Lagrangian(limits(RAIL), 1.0, 1), states), states)
    assert slope[0, 0, 0] > 0 > slope[0, 1, 0]
    assert slope[0, 2, 0] == 0 == slope[..., 1].abs().max()


def test_what_is_gained_behind_a_limit_is_lost_and_nothing_else() -> None:
    way = torch.stack([at(0.0, 0.0), at(0.0, 3.0), at(0.0, 0.0)])  # the second leaves, and returns
    costs = torch.tensor([[0.5, 0.5], [0.2, 0.2], [0.0, 0.0]]).double()
    found = [
        Lagrangian(limits(RAIL), 1.0, 3).of(way[:, i : i + 1], costs[:, :1], 0.6) for i in (0, 1)
    ]
    proxy = 4.0 * (1.0 + 2.0 / 0.2 - 1.0)
    assert float(found[0]) == pytest.approx(0.7)
    assert float(found[1]) == pytest.approx(0.5 + 1.0 + 1.0 + 0.05 * proxy)


def test_without_a_breach_it_is_the_cost() -> None:
    states = at(0.0, 0.5, -0.3)[None]
    assert float(value(Lagrangian(limits(RAIL), 9.0, 1), states, 0.3)) == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        (Limit("cart", 0.0, 1.0), "one of the states position, velocity, got 'cart'"),
        (Limit("position", -0.2, 1.0), "must lie beyond its start, 0 ± 0.1 m"),
        (Limit("velocity", 0.5, 1.0), "must lie beyond its start"),
    ],
)
def test_a_limit_that_does_not_fit_the_task_is_refused(limit: Limit, says: str) -> None:
    with pytest.raises(InputError, match=says):
        limits(limit)


@pytest.mark.parametrize("ends", [(None, None), (1.0, 1.0), (2.0, -1.0)])
def test_a_limit_needs_bounds_in_order(ends) -> None:
    with pytest.raises(InputError, match="needs a bound, and low below high"):
        Limit("position", *ends)


def test_limits_are_read_from_words_and_from_json() -> None:
    found = read_limits(["x=-0.5:0.5,v=:2", "w=-1:"])
    assert found == (Limit("x", -0.5, 0.5), Limit("v", None, 2.0), Limit("w", -1.0))
    config = Config(search=SearchConfig(limits=found))
    assert from_dict(Config, dataclasses.asdict(config)) == config
    for wrong in ("x", "x=0.5", "x=a:b"):
        with pytest.raises(InputError, match="--limit"):
            read_limits([wrong])


def test_with_limits_model_errors_are_correlated_from_the_first_trial_on() -> None:
    free = SearchConfig(correlations=(0.0, 0.8))
    bound = dataclasses.replace(free, limits=(RAIL,))
    assert [free.correlation_of(trial) for trial in (1, 2)] == [0.0, 0.8]
    assert [bound.correlation_of(trial) for trial in (1, 2)] == [0.8, 0.8]


# --- a search -------------------------------------------------------------------------------------


def line_limits(high: float) -> Limits:
    number = torch.ones(1, dtype=torch.float64)
    return Limits((0,), number, 0 * number, high * number, 0.95)


def searched(high: float | None):
    problem = line_problem()
    if high is not None:
        problem = dataclasses.replace(problem, limits=line_limits(high))
    config = SearchConfig(
        particles=20,
        steps=(120,),
        phases=(Phase(0.1, until=0.5), Phase(0.02)),
        restarts=(0,),
        evaluation_particles=200,
    )
    search = PolicySearch(config, torch.Generator().manual_seed(0))
    return search.run(problem, line_policy(), line_policy, trial=1).best


def test_a_search_keeps_a_limit_that_is_short_of_its_goal() -> None:
    free, bound = searched(None), searched(0.6)
    assert free.kept is None
    assert float(free.particles.states.max()) > 0.9
    assert bound.admissible
    assert bound.kept is not None
    assert bound.kept >= 0.95
    end = bound.particles.states[-1].mean()
    assert 0.35 < float(end) < 0.6  # as near to its goal as it may


def test_a_candidate_that_breaks_a_limit_ranks_behind_all_that_do_not() -> None:
    best = searched(None)
    broken = dataclasses.replace(best, kept=0.1, admissible=False)
    assert broken.rank == math.inf > best.rank
    assert broken.fails(SearchConfig(), 1e9)


# --- an agent -------------------------------------------------------------------------------------


def learned(limit: Limit, trials: int = 1, **search) -> tuple[MCPILCO, PointEnv]:
    env = PointEnv()
    numbers = dataclasses.replace(TINY.search, limits=(limit,), **search)
    config = dataclasses.replace(TINY, search=numbers, exploration=4 * STEPS)
    agent = MCPILCO("SumOfGaussians", env, config=config, seed=1)
    return agent.learn(agent.timesteps_of(trials)), env


def test_random_episodes_end_half_way_to_a_limit() -> None:
    agent, _ = learned(Limit("velocity", -0.5, 0.5))
    explored = agent.transitions.states[: 4 * STEPS, 1]
    assert np.abs(explored).max() <= 0.5 * EXPLORED  # of states that a random input acted on
    assert len(agent.env.seeds) > 5  # more episodes, as they end early


def test_random_inputs_towards_a_limit_leave_no_speed() -> None:
    _, env = learned(Limit("position", -60.0, 60.0))
    u = np.array(env.actions[:STEPS])[:, 0]
    np.testing.assert_allclose(u[:4], u[0] * np.array([1, -1, -1, 1]))


def test_a_policy_that_is_not_predicted_to_keep_the_limits_is_not_tried() -> None:
    numbers = {"kept": 0.99999, "steps": (1,), "evaluation_particles": 1000}
    agent, _ = learned(Limit("velocity", -0.4, 0.4), trials=2, **numbers)
    refused = [result for result in agent.results if result.failure]
    assert refused
    for result in refused:
        assert "not tried" in result.failure
        assert result.limits_kept < 0.99999
        assert result.prediction is None
        assert np.abs(result.rollout.states[:-1, 1]).max() < 0.4 * EXPLORED + 0.1


def test_a_trial_says_whether_its_rollout_crossed_a_limit() -> None:
    agent, _ = learned(Limit("velocity", -9.0, 9.0))
    [result] = agent.results
    assert (result.limits_kept, result.limits_crossed) == (1.0, False)
    assert result.failure is None


def test_a_limit_that_the_brake_holds_is_no_concern_of_the_search() -> None:
    """The brake acts on a policy's commands, on the system and in the particles."""
    agent, env = learned(Limit("position", -0.4, 0.4), trials=2, kept=0.99999, steps=(1,))
    assert agent.policy.brake.holds
    assert [r.failure for r in agent.results] == [None, None]
    assert [r.limits_crossed for r in agent.results] == [False, False]
    assert len(env.seeds) == 6  # no rollout of random inputs ends early
    torch.testing.assert_close(agent.policy.brake.push, torch.ones(1, 1).double(), rtol=0.1, atol=0)
    far = agent.predict(np.array([0.35, 1.0]))[0]
    assert far == pytest.approx(-2.0)


def test_a_saved_agent_brakes_alike(tmp_path) -> None:
    agent, env = learned(Limit("position", -0.4, 0.4))
    again = MCPILCO.load(agent.save(tmp_path / "agent"), env)
    rows = np.random.default_rng(0).normal(size=(50, 2))
    assert agent.policy.brake.holds
    np.testing.assert_array_equal(again.predict(rows)[0], agent.predict(rows)[0])
    assert torch.equal(again.policy.brake.reach, agent.policy.brake.reach)


def test_limits_of_a_late_actuator_are_refused() -> None:
    with pytest.raises(InputError, match="limits go with model.delay 0"):
        Config(search=SearchConfig(limits=(RAIL,)), model=ModelConfig(delay=0.2))


def test_without_limits_nothing_is_said_of_them() -> None:
    agent = MCPILCO("SumOfGaussians", PointEnv(), config=TINY).learn(2 * STEPS)
    assert agent.results[0].limits_kept is agent.results[0].limits_crossed is None
