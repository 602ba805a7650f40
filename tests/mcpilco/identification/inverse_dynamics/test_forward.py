from __future__ import annotations

import numpy as np
import pytest
import torch

from mcpilco.bodies import accelerations as true_accelerations
from mcpilco.bodies import mass_matrix
from mcpilco.identification import Report
from mcpilco.identification.inverse_dynamics import (
    FeedForward,
    InverseDynamics,
    accelerations,
    fit_inverse_dynamics,
    inertia,
)
from mcpilco.identification.inverse_dynamics.model import Fitted
from mcpilco.typing import InputError, NotPositiveDefiniteError
from tests.mcpilco.identification.inverse_dynamics.robots import measured, random_robot


@pytest.fixture(scope="module")
def robot():
    return random_robot(("hinge", "slide", "hinge"), np.random.default_rng(0))


@pytest.fixture(scope="module")
def exact(robot):
    """A model with the true geometry, of torques without noise."""
    return fit_inverse_dynamics(
        measured(robot, np.random.default_rng(1), 200), "fe", chain=robot, friction=False
    )


@pytest.fixture(scope="module")
def poor(robot):
    """A model that knows nothing, of few torques."""
    return fit_inverse_dynamics(
        measured(robot, np.random.default_rng(1), 80, noise=1.0), "rbf", tuned_on=50
    )


@pytest.fixture(scope="module")
def states(robot):
    data = measured(robot, np.random.default_rng(2), 12)
    return [torch.as_tensor(array) for array in (data.q, data.dq, data.tau)]


def test_inertia_is_that_of_the_robot(robot, exact, states):
    found = inertia(exact, states[0].reshape(3, 4, 3))
    expected = mass_matrix(robot, states[0].numpy()).reshape(3, 4, 3, 3)
    np.testing.assert_allclose(found.matrix, expected, atol=1e-8)
    assert found.positive.all()
    assert found.asymmetry.max() < 1e-8


class Crooked(InverseDynamics):
    """tau = M q'', M not symmetric; the second joint's torques are ten times smaller."""

    def __init__(self) -> None:
        super().__init__(Fitted("none", ("a", "b"), (1.0, 0.1), Report(True, 0)))

    def __call__(self, motion):
        return motion[..., 4:] @ torch.tensor([[2.0, 0.5], [0.9, 1.0]]).double().mT

    def to_groups(self):
        return {}


def test_of_two_entries_the_one_with_the_smaller_torques_counts_more():
    found = inertia(Crooked(), torch.zeros(2).double())
    # 0.9 tells the second joint, with weights 1 / 0.1^2 and 1 / 1^2
    entry = (100.0 * 0.9 + 0.5) / 101.0
    expected = torch.tensor([[2.0, entry], [entry, 1.0]]).double()
    torch.testing.assert_close(found.matrix, expected)
    torch.testing.assert_close(found.asymmetry, torch.tensor(0.2).double())


@pytest.mark.slow
def test_forward_dynamics_are_those_of_the_robot(robot, exact, states):
    found = accelerations(exact, *states)
    expected = true_accelerations(robot, *(array.numpy() for array in states))
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.slow
def test_forward_dynamics_of_a_learned_polynomial_are_close():
    rng = np.random.default_rng(3)
    robot = random_robot(("hinge", "hinge"), rng)
    model = fit_inverse_dynamics(
        measured(robot, rng, 400, noise=1e-3), "gip", friction=False, tuned_on=150
    )
    test = measured(robot, rng, 50)
    q, dq, tau = (torch.as_tensor(array) for array in (test.q, test.dq, test.tau))
    np.testing.assert_allclose(accelerations(model, q, dq, tau).detach(), test.ddq, atol=0.1)


def test_forward_dynamics_are_differentiable(exact, states):
    inputs = [array[:2].clone().requires_grad_() for array in states]
    assert torch.autograd.gradcheck(lambda *args: accelerations(exact, *args), inputs)


def test_an_inertia_that_is_not_positive_definite_is_refused(poor, states):
    assert not inertia(poor, states[0]).positive.all()
    with pytest.raises(
        NotPositiveDefiniteError, match=r"not positive definite at \d+ of 12.*joint0"
    ):
        accelerations(poor, *states)


def test_or_answered_with_nan_where_it_is_not(poor, states):
    positive = inertia(poor, states[0]).positive
    found = accelerations(poor, *states, indefinite="nan")
    assert torch.equal(found.isfinite().all(-1), positive)


def test_gradients_pass_by_states_without_an_answer(poor, states):
    q = states[0].clone().requires_grad_()
    found = accelerations(poor, q, *states[1:], indefinite="nan")
    found[found.isfinite().all(-1)].sum().backward()
    assert q.grad.isfinite().all()


def follow(robot, model, plan, dt: float) -> float:
    """Largest error [rad or m] on a planned motion."""
    q, dq = plan[0][:1].copy(), plan[1][:1].copy()
    controller = FeedForward(model, np.full(3, 20.0), np.full(3, 6.0))
    worst = 0.0
    for q_d, dq_d, planned in zip(*plan[:2], controller.plan(*plan), strict=True):
        worst = max(worst, float(np.abs(q_d - q).max()))
        tau = controller.torque(planned, q_d - q, dq_d - dq)
        dq = dq + dt * true_accelerations(robot, q, dq, tau)
        q = q + dt * dq
    return worst


@pytest.mark.slow
def test_feed_forward_follows_a_plan_that_feedback_alone_does_not(robot, exact):
    dt = 0.002
    t, w = dt * np.arange(500)[:, None], np.array([2.0, 3.0, 2.5])
    plan = 0.3 * np.sin(w * t), 0.3 * w * np.cos(w * t), -0.3 * w**2 * np.sin(w * t)
    assert follow(robot, exact, plan, dt) < 0.02 < 0.2 < follow(robot, None, plan, dt)


def test_negative_gains_are_refused(exact):
    with pytest.raises(InputError, match="proportional must be a gain >= 0"):
        FeedForward(exact, np.array([-1.0, 1.0, 1.0]), np.ones(3))
