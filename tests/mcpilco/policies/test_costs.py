"""Laws of costs: bounds, gradients, the thesis's values."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from mcpilco.policies.costs import (
    QuadraticCost,
    SaturatingCost,
    TipCost,
    cart_pole_cost,
    costs_along,
    held,
)
from mcpilco.typing import Cost, InputError, WidenableCost

SATURATING = {
    "thesis": cart_pole_cost(),
    "later": cart_pole_cost(1.0, 3.0),
    "all four": SaturatingCost(
        (0, 1, 2, 3), (0.5, 0.0, -1.0, 2.0), (1.0, 2.0, 0.5, 4.0), (False, True, False, True)
    ),
}
TIP = TipCost((1, 2), (0.6, 0.4), 0.3, foot=0, foot_lengthscale=2.0)
BOUNDED = {**SATURATING, "tip": TIP}
QUADRATIC = QuadraticCost((1.0, 0.0, math.pi, 0.0), (1.0, 0.1, 2.0, 0.0), (0.05,))
ALL = {**BOUNDED, "quadratic": QUADRATIC}

numbers = st.floats(-1e3, 1e3)


def some_states(*batch: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    return 3 * torch.randn(*batch, 4, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("name", ALL)
def test_every_cost_fits_the_protocol(name: str) -> None:
    assert isinstance(ALL[name], Cost)


@pytest.mark.parametrize("name", BOUNDED)
@given(state=st.lists(numbers, min_size=4, max_size=4))
def test_saturating_cost_is_between_0_and_1(name: str, state: list[float]) -> None:
    cost = float(BOUNDED[name](torch.tensor(state, dtype=torch.float64)))
    assert 0.0 <= cost <= 1.0


@pytest.mark.parametrize("name", ALL)
def test_gradient_equals_finite_differences(name: str) -> None:
    states = some_states(5).requires_grad_()
    inputs = torch.linspace(-2, 2, 5, dtype=torch.float64)[:, None].requires_grad_()
    assert torch.autograd.gradcheck(
        lambda x, u: ALL[name](x, u) + 0.0 * u.sum(-1), (states, inputs)
    )


@pytest.mark.parametrize("name", ALL)
def test_batch_equals_loop(name: str) -> None:
    states, inputs = some_states(3, 5), torch.ones(3, 5, 1, dtype=torch.float64)
    costs = ALL[name](states, inputs)
    for i in range(3):
        for j in range(5):
            torch.testing.assert_close(costs[i, j], ALL[name](states[i, j], inputs[i, j]))


def test_costs_along_a_rollout_are_those_of_its_steps() -> None:
    states, inputs = some_states(6), torch.linspace(-2, 2, 6, dtype=torch.float64)[:, None]
    costs = costs_along(QUADRATIC, states.numpy(), inputs.numpy())
    expected = [float(QUADRATIC(states[t], inputs[t])) for t in range(6)]
    assert costs.tolist() == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        ((0.0, 0.0, math.pi, 0.0), 0.0),
        ((0.0, 3.0, -math.pi, -7.0), 0.0),  # the other way up, and velocities are free
        ((0.0, 0.0, 0.0, 0.0), 1 - math.exp(-(math.pi**2))),  # hanging
        ((1.5, 0.0, math.pi, 0.0), 1 - math.exp(-1)),
        ((-1.5, 0.0, math.pi - 1.0, 0.0), 1 - math.exp(-2)),
    ],
)
def test_cart_pole_cost_has_the_thesis_values(state: tuple[float, ...], expected: float) -> None:
    cost = cart_pole_cost()(torch.tensor(state, dtype=torch.float64))
    assert float(cost) == pytest.approx(expected, abs=1e-15)


def test_lengthscale_is_where_the_cost_is_1_less_1_over_e() -> None:
    cost = cart_pole_cost(0.7, 2.0)
    away = torch.tensor([[0.7, 0.0, math.pi, 0.0], [0.0, 0.0, math.pi + 2.0, 0.0]])
    torch.testing.assert_close(cost(away), torch.full((2,), 1 - math.exp(-1)))


@pytest.mark.parametrize("name", SATURATING)
def test_a_wider_cost_is_lower_everywhere_and_zero_at_the_same_target(name: str) -> None:
    cost = SATURATING[name]
    assert isinstance(cost, WidenableCost)
    states = some_states(20)
    assert (cost.widened(3.0)(states) < cost(states)).all()
    assert cost.widened(1.0) == cost
    target = torch.zeros(4, dtype=torch.float64)
    target[list(cost.components)] = torch.tensor(cost.targets, dtype=torch.float64)
    assert float(cost.widened(3.0)(target)) == pytest.approx(float(cost(target)), abs=1e-12)


def test_quadratic_cost_is_the_regulators() -> None:
    state = torch.tensor([3.0, 2.0, math.pi + 1.0, 9.0], dtype=torch.float64)
    force = torch.tensor([-4.0], dtype=torch.float64)
    expected = 1.0 * 2**2 + 0.1 * 2**2 + 2.0 * 1**2 + 0.05 * 4**2
    assert float(QUADRATIC(state, force)) == pytest.approx(expected, rel=1e-14)
    at_target = torch.tensor(QUADRATIC.targets, dtype=torch.float64)
    assert float(QUADRATIC(at_target, torch.zeros(1, dtype=torch.float64))) == 0.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SaturatingCost((0, 1), (0.0,), (1.0, 1.0), (False, False)), "for each component"),
        (lambda: SaturatingCost((0,), (0.0,), (0.0,), (False,)), "positive"),
        (lambda: SaturatingCost((0,), (0.0,), (math.nan,), (False,)), "positive"),
        (lambda: QuadraticCost((0.0, 0.0), (1.0,), (1.0,)), "one state weight"),
        (lambda: QuadraticCost((0.0,), (1.0,), (-1.0,)), "not be negative"),
    ],
)
def test_wrong_numbers_are_answered_with_a_sentence(make, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()


def test_the_tip_costs_its_distance_from_upright() -> None:
    """Two links hang at 0.6 + 0.4 m below the foot, 2 m from where they should be."""
    cost = TipCost((1, 2), (0.6, 0.4), 2.0, foot=0)

    def distance(foot: float, first: float, second: float) -> float:
        state = torch.tensor([foot, first, second], dtype=torch.float64)
        return 2.0 * math.sqrt(-math.log1p(-float(cost(state))))

    assert distance(0.0, 0.0, 0.0) == 0.0
    assert distance(0.0, math.pi, 0.0) == pytest.approx(2.0)
    assert distance(0.0, 0.0, math.pi) == pytest.approx(0.8)  # the second folds down
    assert distance(0.0, math.pi / 2, 0.0) == pytest.approx(math.sqrt(2.0))
    assert distance(0.5, 0.0, 0.0) == pytest.approx(1.0)  # l / l_x = 2


def test_a_wider_tip_cost_is_lower_everywhere_and_zero_upright() -> None:
    assert isinstance(TIP, WidenableCost)
    states = some_states(20)
    assert (TIP.widened(3.0)(states) < TIP(states)).all()
    assert TIP.widened(1.0) == TIP
    assert float(TIP.widened(3.0)(torch.zeros(4, dtype=torch.float64))) == 0.0


@given(angle=st.floats(-3.0, 3.0), turns=st.integers(-3, 3))
def test_the_tip_costs_the_same_after_full_turns(angle: float, turns: int) -> None:
    cost = TipCost((0,), (1.0,), 1.0)
    angles = torch.tensor([[angle], [angle + 2 * math.pi * turns]], dtype=torch.float64)
    first, turned = cost(angles)
    torch.testing.assert_close(first, turned)


@pytest.mark.parametrize(
    "entries",
    [
        {"angles": ()},
        {"angles": (0, 1)},
        {"lengths": (0.0,)},
        {"lengthscale": -1.0},
        {"foot_lengthscale": 0.0},
    ],
)
def test_a_chain_that_cannot_be_is_refused(entries: dict) -> None:
    with pytest.raises(InputError, match="TipCost"):
        TipCost(**{"angles": (0,), "lengths": (1.0,), "lengthscale": 1.0, **entries})


def test_an_episode_that_ended_early_keeps_its_last_cost() -> None:
    assert held(np.array([0.5, 0.25]), 4).tolist() == [0.5, 0.25, 0.25, 0.25]
    assert held(np.array([0.5, 0.25]), 2).tolist() == [0.5, 0.25]
