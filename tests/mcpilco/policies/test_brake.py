"""Laws of the brake: what it learns, what it lets pass, and that limits hold under any command."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
import torch

from mcpilco.config import Limit
from mcpilco.data import Transitions
from mcpilco.policies import BALANCED, Brake, careful
from mcpilco.task import TaskSpec
from tests.mcpilco.point import TASK as POINT

CART, POLE, LENGTH, FRICTION, GRAVITY = 0.5, 0.5, 0.5, 0.1, 9.82
FIRST_MOMENT = POLE * LENGTH / 2
RAIL = Limit("cart_position", -0.5, 0.5)
NOISE = 0.01


def derivative(s: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The cart-pole's equations of motion, as the env's docstring has them."""
    _, v, q, w = s.T
    a, b = FIRST_MOMENT * np.cos(q), POLE * LENGTH**2 / 3
    push = u - FRICTION * v + FIRST_MOMENT * np.sin(q) * w**2
    torque = -FIRST_MOMENT * GRAVITY * np.sin(q)
    det = (CART + POLE) * b - a**2
    return np.stack(
        [v, (b * push - a * torque) / det, w, ((CART + POLE) * torque - a * push) / det]
    ).T


def moved(s: np.ndarray, u: np.ndarray, dt: float, parts: int = 20) -> np.ndarray:
    """The states a step later, by Runge and Kutta."""
    h = dt / parts
    for _ in range(parts):
        k1 = derivative(s, u)
        k2 = derivative(s + h / 2 * k1, u)
        k3 = derivative(s + h / 2 * k2, u)
        s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + derivative(s + h * k3, u))
    return s


def seen(s: np.ndarray, random: np.random.Generator) -> np.ndarray:
    return s + NOISE * random.standard_normal(s.shape)


def recorded(dt: float, seed: int, steps: int = 30) -> Transitions:
    """A rollout of uniform random inputs, measured with noise."""
    random = np.random.default_rng(seed)
    s = 0.1 * random.standard_normal((1, 4))
    states, inputs = [seen(s, random)[0]], []
    for _ in range(steps):
        inputs.append(random.uniform(-10, 10, 1))
        s = moved(s, inputs[-1], dt)
        states.append(seen(s, random)[0])
    return Transitions(*map(np.array, (states[:-1], inputs, states[1:])))


def brake_of(task: TaskSpec, *limits: Limit, bound: float = 10.0) -> Brake:
    U = len(task.input_names)
    return Brake(limits or (RAIL,), task, [-bound] * U, [bound] * U, len(task.state_names))


def learned(task: TaskSpec, seed: int = 0, *limits: Limit) -> Brake:
    brake = brake_of(task, *limits)
    brake.learn(recorded(task.dt, seed))
    return brake


@pytest.mark.parametrize("dt", [0.05, 0.1])
def test_it_learns_the_point_that_the_input_alone_moves(task: TaskSpec, dt: float) -> None:
    brake = learned(dataclasses.replace(task, dt=dt))
    assert brake.holds
    np.testing.assert_allclose(brake.lever[0], [FIRST_MOMENT / (CART + POLE), 0.0], atol=0.01)
    np.testing.assert_allclose(brake.push[0], [1 / (CART + POLE)], rtol=0.05)
    assert 0.125 < float(brake.reach[0]) < 0.2


@pytest.mark.one_in(4)
@pytest.mark.parametrize("dt", [0.05, 0.1])
@pytest.mark.parametrize("held", [1, 3, pytest.param(6, marks=pytest.mark.slow)])
def test_bang_bang_commands_stay_within_the_limits(task: TaskSpec, dt: float, held: int) -> None:
    """Rollouts in the true equations, of commands at the bounds that are held for some steps."""
    task, random, crossed = dataclasses.replace(task, dt=dt), np.random.default_rng(held), []
    for seed in range(5):
        brake, s = learned(task, seed), 0.1 * random.standard_normal((200, 4))
        furthest = np.zeros(len(s))
        for step in range(round(3 / dt)):
            if step % held == 0:
                commands = 10.0 * random.choice([-1, 1], (len(s), 1))
            states = torch.from_numpy(seen(s, random))
            s = moved(s, brake(states, torch.from_numpy(commands)).numpy()[:, 0], dt, 5)
            furthest = np.maximum(furthest, np.abs(s[:, 0]))
        crossed.append(furthest > 0.5)
    assert np.mean(crossed) <= 0.002


def test_without_it_they_cross(task: TaskSpec) -> None:
    random = np.random.default_rng(0)
    s = 0.1 * random.standard_normal((100, 4))
    for _ in range(30):
        s = moved(s, 10.0 * random.choice([-1, 1], len(s)), task.dt, 5)
    assert (np.abs(s[:, 0]) > 0.5).mean() > 0.5


def anywhere(count: int = 500) -> tuple[torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(0)
    states = torch.randn(count, 4, generator=random, dtype=torch.float64)
    states *= torch.tensor([0.3, 2.0, 3.0, 8.0])
    return states, 20 * torch.rand(count, 1, generator=random, dtype=torch.float64) - 10


def test_inputs_never_leave_the_actuators_bounds_and_are_monotone_in_commands(task) -> None:
    brake, (states, commands) = learned(task), anywhere()
    inputs = brake(states, commands)
    assert inputs.abs().max() <= 10.0 + 1e-12
    assert (inputs - commands).abs().max() > 5.0
    assert (brake(states, (commands + 1.0).clamp_max(10.0)) >= inputs - 1e-12).all()


def test_far_from_the_limits_and_at_rest_commands_pass(task: TaskSpec) -> None:
    brake, commands = learned(task), anywhere()[1]
    torch.testing.assert_close(brake(torch.zeros(len(commands), 4).double(), commands), commands)


def test_it_pushes_back_from_both_sides(task: TaskSpec) -> None:
    states = torch.tensor([[0.3, 2.0, 0.0, 0.0], [-0.3, -2.0, 0.0, 0.0]]).double()
    commands = torch.tensor([[10.0], [-10.0]]).double()
    torch.testing.assert_close(learned(task)(states, commands), -commands)
    one = learned(task, 0, Limit("cart_position", high=0.5))
    torch.testing.assert_close(one(states, commands), torch.tensor([[-10.0], [-10.0]]).double())


def test_its_gradient_is_that_of_finite_differences(task: TaskSpec) -> None:
    brake, (states, commands) = learned(task), anywhere(40)
    given = states.requires_grad_(), commands.requires_grad_()
    assert torch.autograd.gradcheck(brake, given, atol=1e-4)


def test_its_program_computes_the_same(task: TaskSpec) -> None:
    brake, (states, commands) = learned(task), anywhere()
    assert brake.program is not None
    found = brake.program(torch.cat([states, commands], -1))
    torch.testing.assert_close(found, brake(states, commands))


def test_before_it_has_learned_it_changes_nothing(task: TaskSpec) -> None:
    brake, (states, commands) = brake_of(task), anywhere()
    brake.learn(recorded(0.1, 0, steps=4))
    assert not brake.holds
    assert brake.program is None
    assert torch.equal(brake(states, commands), commands)


def test_it_does_not_hold_what_no_input_stops(task: TaskSpec) -> None:
    """The angle of a pole that only its cart moves, and a velocity."""
    assert not learned(task, 0, Limit("pole_angle", -1.0, 1.0)).held
    speeds = learned(task, 0, RAIL, Limit("pole_velocity", high=12.0))
    assert speeds.held == [0]
    assert not speeds.holds


def test_it_is_the_same_once_its_numbers_are_loaded(task: TaskSpec) -> None:
    brake, copy, given = learned(task), brake_of(task), anywhere()
    copy.load_state_dict(brake.state_dict())
    assert torch.equal(copy(*given), brake(*given))


def test_two_inputs_that_push_the_same_state_brake_together() -> None:
    task = dataclasses.replace(POINT, input_names=("left", "right"), input_units=("N", "N"))
    random = np.random.default_rng(0)
    states, inputs = random.standard_normal((40, 2)), random.uniform(-2, 2, (40, 2))
    faster = states[:, 1] + task.dt * inputs @ [1.0, -0.5]
    following = np.column_stack([states[:, 0] + task.dt * (states[:, 1] + faster) / 2, faster])
    brake = brake_of(task, Limit("position", -1.0, 1.0), bound=2.0)
    brake.learn(Transitions(states, inputs, following))
    torch.testing.assert_close(brake.push, torch.tensor([[1.0, -0.5]]).double())
    ahead = brake(torch.tensor([0.9, 3.0]).double(), torch.tensor([2.0, -2.0]).double())
    torch.testing.assert_close(ahead, torch.tensor([-2.0, 2.0]).double())


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.05, 0.1])
def test_a_first_rollout_learns_it_on_the_way_and_stays_within(task: TaskSpec, dt: float) -> None:
    task, crossed, needed = dataclasses.replace(task, dt=dt), 0, []
    for seed in range(40):
        random, brake = np.random.default_rng(seed), brake_of(task)
        draws = (random.uniform(-10, 10, 1) for _ in itertools.count())
        act, s = careful(brake, draws, ()), 0.1 * random.standard_normal((1, 4))
        furthest, first = 0.0, np.inf
        for step in range(round(3 / dt)):
            s = moved(s, act(torch.from_numpy(seen(s, random)[0])).numpy(), dt, 5)
            furthest = max(furthest, abs(s[0, 0]))
            first = min(first, step) if brake.holds else first
        crossed += furthest > 0.5
        needed.append(first)
    assert crossed == 0
    assert np.median(needed) < 15


def test_until_it_holds_signs_are_balanced() -> None:
    brake = brake_of(POINT, Limit("velocity", -9.0, 9.0), bound=2.0)
    act = careful(brake, iter(np.full((9, 1), 1.5)), ())
    inputs = [float(act(torch.zeros(2).double())) for _ in range(4)]
    assert inputs == [1.5 * sign for sign in BALANCED]
