"""Learned models of late actuators, on the way from an actuator that answers at once."""

from __future__ import annotations

import pytest
import torch

from mcpilco import fused
from mcpilco.config import ModelConfig
from mcpilco.lateness import answering_sooner
from mcpilco.rollout import rollout
from tests.mcpilco.fused.test_program import drawn, outcome

PAST = 2


@pytest.fixture
def late(task):
    """A model of states behind which two inputs stand, and a policy that sees them."""
    return drawn(task, ModelConfig(memory=PAST))


def some(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    shapes = (count, 4 + PAST), (count, 1), (count, 2)
    return tuple(torch.randn(s, generator=generator, dtype=torch.float64) for s in shapes)


def test_the_whole_way_ends_at_the_model_itself(late):
    states, inputs, noise = some(9)
    found = answering_sooner(late[0], PAST, 1.0).step(states, inputs, noise)
    torch.testing.assert_close(found, late[0].step(states, inputs, noise))


def test_at_the_beginning_the_past_is_not_felt_and_yet_remembered(late):
    states, inputs, noise = some(9)
    at_once = answering_sooner(late[0], PAST, 0.0)
    other = torch.cat([states[:, :4], states[:, 4:] + 3.0], 1)
    first, second = (at_once.step(x, inputs, noise) for x in (states, other))
    torch.testing.assert_close(first[:, :4], second[:, :4], rtol=0, atol=0)
    assert ((first - states)[:, :4] != 0.0).any()
    torch.testing.assert_close(first[:, 4:], torch.cat([inputs, states[:, 4:5]], 1))


def test_half_way_it_is_asked_between_the_past_and_the_present(late):
    states, inputs, noise = some(9)
    between = torch.cat([states[:, :4], (states[:, 4:] + inputs) / 2], 1)
    found = answering_sooner(late[0], PAST, 0.5).step(states, inputs, noise)
    torch.testing.assert_close(found[:, :4], late[0].step(between, inputs, noise)[:, :4])


@pytest.mark.slow  # compiles what no other test needs
def test_the_compiled_loops_go_the_same_way(late):
    dynamics = answering_sooner(late[0], PAST, 0.3)
    assert fused.supports(dynamics, late[1])
    plain, fast = (outcome(how, dynamics, late[1], 4 + PAST) for how in (rollout, fused.rollout))
    torch.testing.assert_close(fast[0].states, plain[0].states, rtol=1e-7, atol=1e-7)
    for a, b in zip(fast[1], plain[1], strict=True):
        torch.testing.assert_close(a, b, rtol=1e-6, atol=1e-7 * float(b.abs().max()))
