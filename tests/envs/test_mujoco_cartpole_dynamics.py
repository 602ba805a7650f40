"""Laws of the cart-pole that MuJoCo simulates: it moves as its equations say."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from envs.cartpole_dynamics import CartPoleDynamics
from envs.mujoco_cartpole_dynamics import MujocoCartPoleDynamics, count_steps, fitting_step
from envs.mujoco_cartpole_model import build_model
from mcpilco.typing import EnvError, InputError

PILCO = CartPoleDynamics()
OTHER = CartPoleDynamics(
    cart_mass=1.3, pole_mass=0.2, pole_length=0.8, cart_friction=0.7, gravity=3.7
)


def simulated(constants: CartPoleDynamics, timestep: float) -> MujocoCartPoleDynamics:
    model = build_model(constants)
    model.opt.timestep = timestep
    return MujocoCartPoleDynamics(model)


def some_states(n: int) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(n, 4)) * [0.5, 1.0, 2.0, 2.0]


@pytest.mark.parametrize("strength", [0.0, 10.0], ids=["free", "forced"])
@pytest.mark.parametrize(
    ("constants", "low", "high"),
    # of PILCO's constants the terms of order 4 are so small that those of order 5 show beside them
    [(PILCO, 3.7, 5.2), (OTHER, 3.9, 4.1)],
    ids=["pilco", "other"],
)
def test_motion_becomes_the_analytic_one_with_order_4(constants, low, high, strength):
    forces = strength * np.random.default_rng(1).uniform(-1, 1, (10, 20))

    def end(dynamics):
        states = some_states(20)
        for force in forces:
            states = dynamics.advance(states, force, 0.1)[-1]
        return states

    steps = np.array([0.02, 0.01, 0.005, 0.0025])
    analytic = end(constants)
    distances = [np.abs(end(simulated(constants, h)) - analytic).max() for h in steps]
    slope = np.polyfit(np.log(steps), np.log(distances), 1)[0]
    assert low < slope < high
    assert distances[-1] < 1e-6


def test_energy_is_conserved_without_friction_and_force():
    constants = CartPoleDynamics(cart_friction=0.0)
    states = some_states(20)
    path = simulated(constants, 0.002).advance(states, 0.0, 3.0, samples=30)
    change = constants.energy(path) - constants.energy(states)
    assert 0 < np.abs(change).max() < 1e-6


def test_samples_are_those_of_shorter_motions():
    dynamics, states = simulated(PILCO, 0.002), some_states(3)
    path = dynamics.advance(states, 4.0, 0.1, samples=10)
    assert path.shape == (10, 3, 4)
    for sample in path:
        states = dynamics.advance(states, 4.0, 0.01)[0]
        np.testing.assert_array_equal(sample, states)


def test_batch_is_a_loop_of_single_motions():
    dynamics, states = simulated(OTHER, 0.002), some_states(6)
    forces = np.linspace(-10, 10, 6)
    batch = dynamics.advance(states.reshape(2, 3, 4), forces.reshape(2, 3), 0.1, samples=5)
    assert batch.shape == (5, 2, 3, 4)
    for i in range(6):
        single = dynamics.advance(states[i], forces[i], 0.1, samples=5)
        np.testing.assert_array_equal(batch[:, i // 3, i % 3], single)


def test_motion_depends_on_its_start_and_input_alone():
    dynamics, states = simulated(PILCO, 0.002), some_states(1)
    first = dynamics.advance(states, 3.0, 0.1)
    dynamics.advance(some_states(5), -10.0, 1.0)
    np.testing.assert_array_equal(dynamics.advance(states, 3.0, 0.1), first)
    np.testing.assert_array_equal(copy.deepcopy(dynamics).advance(states, 3.0, 0.1), first)


def test_tip_is_where_the_equations_have_it():
    states = some_states(12).reshape(3, 4, 4)
    tips = simulated(OTHER, 0.002).tip(states)
    # the pole is drawn in front of the cart, so that y differs
    np.testing.assert_allclose(tips[..., ::2], OTHER.tip(states)[..., ::2], atol=1e-12)


def test_unstable_motion_is_told_and_leaves_the_dynamics_usable(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log of its own where it is
    dynamics, states = simulated(PILCO, 0.01), some_states(3)
    before = dynamics.advance(states, 0.0, 0.1)
    wild = states.copy()
    wild[1, 3] = 1e12
    with pytest.raises(EnvError, match="unstable.*timestep") as error:
        dynamics.advance(wild, 0.0, 0.1)
    assert str(wild[1].tolist()) in str(error.value)
    np.testing.assert_array_equal(dynamics.advance(states, 0.0, 0.1), before)


@pytest.mark.parametrize("timestep", [0.003, 0.02, 0.0100001, 1.0])
def test_step_that_does_not_divide_the_time_is_refused_with_one_that_does(timestep):
    with pytest.raises(InputError, match="timestep must divide the 0.01 s") as error:
        count_steps(0.01, timestep)
    proposed = float(str(error.value).split("timestep=")[1].rstrip("."))
    assert count_steps(0.01, proposed) >= 1
    assert proposed == fitting_step(0.01, timestep) <= timestep


@pytest.mark.parametrize(
    ("timestep", "steps"), [(0.01, 1), (0.002, 5), (0.01 / 3, 3), (1e-5, 1000)]
)
def test_steps_are_counted_past_rounding(timestep, steps):
    assert count_steps(0.01, timestep) == steps
