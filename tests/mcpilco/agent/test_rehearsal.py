"""Copies of the process learn three steps, and the agent knows nothing of it."""

from __future__ import annotations

import time

import pytest

import envs  # noqa: F401  registers the ids
from baselines.pilco import PILCO
from mcpilco import MCPILCO
from mcpilco.agent import rehearsal
from mcpilco.agent.rehearsal import rehearsed

ENV = "mcpilco/CartPoleSwingUp-v0"


@pytest.fixture
def cold(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if nothing had been compiled, on a machine with two cores."""
    monkeypatch.setattr(rehearsal, "compiled_before", lambda: False)
    monkeypatch.setattr(rehearsal.os, "cpu_count", lambda: 2)


@pytest.mark.slow  # two processes load, or compile, all that a training runs
def test_a_copy_learns_to_its_end_and_leaves_the_agent_as_it_is(cold: None) -> None:
    agent = MCPILCO("SumOfGaussians", ENV, seed=3)
    with rehearsed(agent) as (callback,):
        callback.on_model_fitted({})
        assert [process.exitcode for process in callback._processes] == [0, 0]
    assert agent.num_timesteps == 0
    assert agent.config == MCPILCO("SumOfGaussians", ENV).config


def test_a_copy_that_is_not_needed_any_more_ends(
    cold: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rehearsal, "_rehearse", lambda agent, loop: time.sleep(60))
    with pytest.raises(KeyboardInterrupt), rehearsed(MCPILCO("SumOfGaussians", ENV)) as waiting:
        raise KeyboardInterrupt
    assert not waiting[0]._processes[0].is_alive()


def test_nothing_is_compiled_that_is_there_or_of_no_use(cold: None) -> None:
    with rehearsed(PILCO("GPMean", ENV)) as waiting:
        assert waiting == []
