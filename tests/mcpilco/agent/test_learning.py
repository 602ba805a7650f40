"""Laws of learning in pieces: an agent that stops at its searches learns what it learns at once."""

from __future__ import annotations

import pytest
import torch

from mcpilco.agent.agent import MCPILCO
from mcpilco.agent.learning import SearchRequest
from tests.mcpilco.point import STEPS, TINY, PointEnv


def make_agent() -> MCPILCO:
    return MCPILCO("SumOfGaussians", PointEnv(), config=TINY, seed=3)


def test_a_learning_stops_at_the_search_of_each_trial() -> None:
    agent, alone = make_agent(), make_agent().learn(3 * STEPS)
    learning = agent.learning(3 * STEPS)
    answer = None
    for trial in (1, 2):
        request = learning.send(answer)
        assert isinstance(request, SearchRequest)
        assert request.trial == trial
        assert len(agent.results) == trial - 1
        answer = request.answer()
    with pytest.raises(StopIteration):
        learning.send(answer)
    assert torch.equal(agent.policy.weights, alone.policy.weights)
    assert [r.real_cost for r in agent.results] == [r.real_cost for r in alone.results]


def test_a_trial_takes_its_own_time_and_that_of_its_search() -> None:
    agent, other = make_agent(), make_agent()
    learning = agent.learning(2 * STEPS)
    request = next(learning)
    other.learn(2 * STEPS)  # meanwhile
    answer = request.answer()
    with pytest.raises(StopIteration):
        learning.send(answer)
    (result,) = agent.results
    assert result.cpu_s > answer.spent.cpu_s > 0
