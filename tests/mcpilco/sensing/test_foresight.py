"""What policies of late actuators are told in a rollout: what they will be told on the system."""

from __future__ import annotations

import pytest
import torch

from mcpilco.dynamics import Delay
from mcpilco.search import rollout
from mcpilco.search.particles import Sensing
from mcpilco.sensing.foresight import Foresight
from mcpilco.sensing.state_predictor import StatePredictor
from mcpilco.task import TaskSpec
from tests.mcpilco.conftest import make_dynamics, make_policy

STEPS, PARTICLES = 9, 5
NOISE = torch.tensor([0.05, 0.1, 0.02, 0.2], dtype=torch.float64)


def told(task: TaskSpec, delay: Delay, noise_std: torch.Tensor = NOISE, spread: float = 1.0):
    """A rollout, the measurements in it, and what the policy saw."""
    generator = torch.Generator().manual_seed(3)
    start, noise, errors = (
        torch.randn(*shape, generator=generator, dtype=torch.float64)
        for shape in ((PARTICLES, 4), (STEPS, PARTICLES, 2), (STEPS, PARTICLES, 4))
    )
    dynamics, policy, seen = make_dynamics(task), make_policy(task), []

    def watched(states, dropout, step):
        seen.append(states)
        return policy(states, dropout, step)

    sensing = Sensing(Foresight(dynamics, delay, noise_std), errors)
    with torch.no_grad():
        particles = rollout(dynamics, watched, 0.3 * start, spread * noise, sensing=sensing)
    measured = particles.states[:-1] + noise_std * errors
    return dynamics, particles, measured, torch.stack(seen)


@pytest.mark.parametrize("whole", [1, 2, 3])
def test_a_policy_is_told_what_a_predictor_tells_of_old_measurements(task, whole: int) -> None:
    dynamics, particles, measured, seen = told(task, Delay(whole))
    predictor = StatePredictor(Delay(whole), dynamics)
    for t in range(whole, STEPS):
        past = particles.inputs[t - whole : t].flip(0).movedim(0, 1)  # newest first
        torch.testing.assert_close(seen[t], predictor(measured[t - whole], past))
        assert (seen[t] - particles.states[t]).abs().min() > 0


def test_before_anything_was_predicted_it_is_told_the_states(task: TaskSpec) -> None:
    _, particles, _, seen = told(task, Delay(2))
    torch.testing.assert_close(seen[0], particles.states[0])


@pytest.mark.parametrize("delay", [Delay(1), Delay(2), Delay(0, 0.5), Delay(1, 0.3)])
def test_where_nothing_errs_it_is_told_the_states(task: TaskSpec, delay: Delay) -> None:
    _, particles, _, seen = told(task, delay, noise_std=0 * NOISE, spread=0.0)
    torch.testing.assert_close(seen, particles.states[:-1])


def test_part_of_a_step_counts_as_a_whole_one(task: TaskSpec) -> None:
    assert torch.equal(told(task, Delay(1, 0.25))[-1], told(task, Delay(2))[-1])
