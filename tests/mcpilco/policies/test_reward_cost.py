"""Laws of a cost learned from rewards, on rewards of which the truth is known."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mcpilco.data import Rollout
from mcpilco.policies.reward_cost import FITTED, RewardCost, with_cost
from mcpilco.typing import InputError
from tests.mcpilco.point import TASK as WITH_COST
from tests.mcpilco.swinging import TASK


def true_reward(states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Of an angle that looks alike after a full turn, a velocity and an input."""
    angle, velocity = states[..., 0], states[..., 1]
    return 3.0 * np.cos(angle) - 0.1 * velocity**2 - 0.05 * inputs[..., 0] ** 2


def samples(count: int, seed: int = 0, turns: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    states = np.column_stack([rng.uniform(-np.pi, np.pi, count), rng.uniform(-4, 4, count)])
    states[:, 0] += 2 * np.pi * turns
    return states, rng.uniform(-2, 2, (count, 1))


def record(count: int = 300, seed: int = 0) -> Rollout:
    states, inputs = samples(count, seed)
    first = np.zeros((1, 2))  # before the first step: no reward is of it
    return Rollout(0.1, np.concatenate([first, states]), inputs, true_reward(states, inputs))


def learned(count: int = 300) -> RewardCost:
    cost = RewardCost(TASK)
    cost.add(record(count))
    cost.fit()
    return cost


@pytest.fixture(scope="module")
def cost() -> RewardCost:
    return learned()


def answer(cost: RewardCost, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    return cost(torch.from_numpy(states), torch.from_numpy(inputs)).detach().numpy()


@pytest.mark.parametrize("turns", [0.0, 3.0])
def test_the_cost_is_the_reward_rescaled_at_states_it_has_not_seen(cost, turns: float) -> None:
    states, inputs = samples(200, seed=1, turns=turns)
    truth = cost.of_rewards(true_reward(states, inputs))
    np.testing.assert_allclose(answer(cost, states, inputs), truth, atol=0.05)


def test_the_best_reward_costs_nothing_and_the_worst_one(cost) -> None:
    assert cost.of_rewards(cost.rewards).min() == 0.0
    assert cost.of_rewards(cost.rewards).max() == 1.0


def test_a_state_far_from_all_that_was_seen_costs_what_the_worst_did(cost) -> None:
    far = answer(cost, np.array([[0.0, 500.0]]), np.zeros((1, 1)))
    assert far == pytest.approx(1.0, abs=1e-6)


def test_the_cost_leads_downhill_where_the_reward_leads_up(cost) -> None:
    states, inputs = samples(50, seed=2)
    x = torch.from_numpy(states).requires_grad_()
    cost(x, torch.from_numpy(inputs)).sum().backward()
    uphill = 3.0 * np.sin(states[:, 0]) / np.ptp(cost.rewards)  # of -r, along the angle
    assert np.corrcoef(x.grad[:, 0].numpy(), uphill)[0, 1] > 0.98


def test_gradients_are_those_of_the_cost(cost) -> None:
    states, inputs = (torch.from_numpy(a).requires_grad_() for a in samples(3, seed=4))
    assert torch.autograd.gradcheck(cost, (states, inputs))


def test_any_leading_axes_are_answered_alike(cost) -> None:
    states, inputs = samples(24, seed=3)
    flat = answer(cost, states, inputs)
    folded = answer(cost, states.reshape(2, 3, 4, 2), inputs.reshape(2, 3, 4, 1))
    np.testing.assert_allclose(folded, flat.reshape(2, 3, 4), rtol=0, atol=1e-12)


def test_more_samples_make_it_truer() -> None:
    states, inputs = samples(200, seed=1)

    def error(cost: RewardCost) -> float:
        truth = cost.of_rewards(true_reward(states, inputs))
        return float(np.sqrt(np.mean((answer(cost, states, inputs) - truth) ** 2)))

    assert error(learned(320)) < 0.3 * error(learned(20))


def test_samples_that_tell_nothing_new_are_left_out() -> None:
    cost = RewardCost(TASK)
    for _ in range(3):
        cost.add(record(FITTED))
    cost.fit()
    assert len(cost.rewards) == 3 * FITTED
    assert cost.samples < FITTED


def test_arrays_bring_the_same_cost_back(cost) -> None:
    cost.baseline = -1.5
    again = RewardCost(TASK)
    again.load_arrays(cost.to_arrays())
    states, inputs = samples(20, seed=5)
    np.testing.assert_array_equal(answer(again, states, inputs), answer(cost, states, inputs))
    assert again.reference == cost.reference == float(cost.of_rewards(np.array([-1.5]))[0])


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("rewards", np.zeros(3)),
        ("states", np.full((300, 2), np.nan)),
        ("inputs", np.zeros((300, 4))),
        ("baseline", np.zeros(2)),
        ("gp.noise_floor", np.zeros(7)),
    ],
)
def test_arrays_of_another_shape_are_refused(cost, name: str, array: np.ndarray) -> None:
    with pytest.raises(InputError):
        RewardCost(TASK).load_arrays({**cost.to_arrays(), name: array})
    missing = {key: value for key, value in cost.to_arrays().items() if key != name}
    with pytest.raises(InputError):
        RewardCost(TASK).load_arrays(missing)


def test_rewards_that_are_all_equal_are_answered_with_a_sentence() -> None:
    cost = RewardCost(TASK)
    with pytest.raises(InputError, match="got 0 equal ones"):
        cost.fit()
    cost.add(Rollout(0.1, np.zeros((4, 2)), np.zeros((3, 1)), np.ones(3)))
    with pytest.raises(InputError, match="got 3 equal ones; give the task a cost"):
        cost.fit()
    with pytest.raises(InputError, match="needs some first"):
        cost(torch.zeros(1, 2), torch.zeros(1, 1))


def test_only_a_task_without_a_cost_gets_one_to_learn() -> None:
    assert with_cost(WITH_COST) is WITH_COST
    assert isinstance(with_cost(TASK).cost, RewardCost)
