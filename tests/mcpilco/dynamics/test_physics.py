"""A plant as the mean: without a residual it is the plant, and its parameters are found."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

import envs  # noqa: F401  registers its plants
from envs.plants import cart_pole
from mcpilco.agent import Model
from mcpilco.config import ModelConfig
from mcpilco.data import Transitions
from mcpilco.dynamics.dynamics import GPDynamics, full_state, speed_integration
from mcpilco.dynamics.features import AngleAugmentation
from mcpilco.dynamics.physics import Parameters, PhysicsDynamics, PhysicsMean
from mcpilco.gp import GP
from mcpilco.kernels import RBF
from mcpilco.typing import InputError

NOISE = 0.01
WRONG = {"cart_mass": 0.6, "pole_mass": 0.4}
PLANT = {
    "format": 1,
    "plant": "mcpilco/CartPoleSwingUp-v0",
    "parameters": WRONG,
    "effects": [],
}


def simulated(task, samples=40, noise=0.0, seed=0) -> Transitions:
    """Random inputs from random states, all measured."""
    rng = np.random.default_rng(seed)
    states = rng.normal(size=(samples, 4)) * [0.5, 1.0, 2.0, 4.0]
    inputs = rng.uniform(-10, 10, (samples, 1))
    after = cart_pole().simulate(states, np.repeat(inputs[:, None], 1, 1), task.dt)[:, -1]
    seen = [x + noise * rng.normal(size=x.shape) for x in (states, after)]
    return Transitions(seen[0], inputs, seen[1])


@pytest.mark.parametrize("law", [speed_integration, full_state])
def test_a_zero_residual_is_the_plant_positions_included(task, law):
    rows, increment = simulated(task), law(task)
    physics = PhysicsMean(cart_pole(), task, increment, uncertainty=0.0, longest=0.01)
    outputs = len(increment.predicted)
    augmentation = AngleAugmentation(4, (2,))
    gp = GP(RBF(6, (outputs,)), noise_std=0.1)
    posterior = gp.condition(torch.zeros(3, 6).double(), torch.zeros(3, outputs).double())
    model = GPDynamics(posterior, augmentation, increment, np.full(outputs, 1e3))
    drawn = PhysicsDynamics(physics, model, rows[:3]).draw(len(rows), torch.Generator())
    states, inputs = torch.from_numpy(rows.states), torch.from_numpy(rows.inputs)
    found = drawn.step(states, inputs, torch.zeros(len(rows), outputs).double())
    np.testing.assert_allclose(found.numpy(), rows.next_states, atol=1e-4)
    assert np.abs(physics.residuals(rows)).max() < 1e-4


def test_parameters_are_found_and_their_uncertainty_covers_what_is_left(task):
    physics = PhysicsMean(cart_pole().where(**WRONG), task, speed_integration(task))
    physics.identify(simulated(task, noise=NOISE), noise_floor=NOISE)
    true = cart_pole().nominal[list(physics.free)]
    nominal = cart_pole().where(**WRONG).nominal[list(physics.free)]
    errors = physics.belief.mean - np.log(true / nominal)
    precision = np.linalg.inv(physics.belief.covariance)
    assert errors @ precision @ errors < 20.5  # the 99.9 % quantile of chi^2 with 5 degrees
    assert abs(errors[physics.names.index("pole_length")]) < 0.02
    # what the masses are to the force is found far better than they are
    ratio = np.zeros(len(errors))
    ratio[[physics.names.index(n) for n in ("cart_mass", "force_gain")]] = 1.0, -1.0
    assert abs(ratio @ errors) < 0.05
    assert ratio @ physics.belief.covariance @ ratio < 0.2 * physics.belief.covariance[0, 0]


def fitted(task, rows, **how) -> Model:
    model = Model(ModelConfig(kernel="rbf", mean="physics", plant=PLANT, **how), task)
    model.fit(rows)
    return model


def test_where_there_are_data_all_particles_agree_and_elsewhere_they_differ(task):
    rows = simulated(task, noise=NOISE)
    dynamics = fitted(task, rows).dynamics(rows)
    drawn = dynamics.draw(200, torch.Generator().manual_seed(0))
    none = torch.zeros(200, 2).double()

    def spread(state, force):
        states = torch.tensor(state).double().expand(200, -1)
        inputs = torch.full((200, 1), force).double()
        return drawn.step(states, inputs, none).std(0)[[1, 3]]

    here = spread(rows.states[0].tolist(), float(rows.inputs[0, 0]))
    assert (here < 2 * NOISE).all()
    assert spread([0.0, 0.0, 0.3, 25.0], 40.0).max() > 2 * here.max()


@pytest.mark.parametrize("sizes", [(1.0, 0.5), (1.0, 1e-20), (1.0, -1e-18)])
def test_a_root_is_of_the_covariance_though_rounding_makes_that_singular(sizes):
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    covariance = turn @ np.diag(sizes) @ turn.T
    root = Parameters(np.zeros(2), covariance).root
    np.testing.assert_allclose(root @ root.T, covariance, atol=1e-15)


def test_a_particle_keeps_its_parameters(task):
    rows = simulated(task, noise=NOISE)
    drawn = fitted(task, rows).dynamics(rows).draw(7, torch.Generator().manual_seed(1))
    states, inputs = torch.randn(7, 4).double(), torch.ones(7, 1).double()
    once, again = (drawn.step(states, inputs, torch.zeros(7, 2).double()) for _ in range(2))
    torch.testing.assert_close(once, again, rtol=0, atol=0)
    assert len(drawn.numbers.unique(dim=0)) > 1


def test_plants_of_a_spread_differ_where_there_are_data_around_what_was_learned(task):
    rows = simulated(task, noise=NOISE)
    alone, wide = (fitted(task, rows, spread=s).dynamics(rows) for s in (None, {"mass": 0.1}))
    none, states = torch.zeros(200, 2).double(), torch.from_numpy(rows.states[:1]).expand(200, -1)
    inputs = torch.from_numpy(rows.inputs[:1]).expand(200, -1)

    def following(dynamics):
        drawn = dynamics.draw(200, torch.Generator().manual_seed(0))
        return drawn.step(states, inputs, none)[:, 1]

    assert following(wide).std() > 5 * following(alone).std()
    assert following(wide).mean() == pytest.approx(float(following(alone).mean()), abs=0.1)
    np.testing.assert_array_equal(wide.model.posterior.alpha, alone.model.posterior.alpha)


def test_a_spread_needs_equations(task):
    with pytest.raises(InputError, match="choose the mean physics"):
        ModelConfig(spread={"mass": 0.1})
    with pytest.raises(InputError, match="no 'wheel' that is not 0"):
        Model(ModelConfig(kernel="rbf", mean="physics", plant=PLANT, spread={"wheel": 0.1}), task)


def test_what_was_learned_is_read_back(task):
    rows = simulated(task, noise=NOISE)
    model = fitted(task, rows)
    again = Model(model.config, task)
    again.load_arrays(model.to_arrays())
    np.testing.assert_array_equal(again.physics.belief.mean, model.physics.belief.mean)
    for mine, its in zip(model.rows(rows), again.rows(rows), strict=True):
        torch.testing.assert_close(mine, its, rtol=0, atol=0)


def test_physics_that_does_not_fit_is_no_physics(task):
    model = Model(ModelConfig(kernel="rbf", mean="physics", plant=PLANT), task)
    arrays = model.to_arrays()
    with pytest.raises(InputError, match="name the plant"):
        model.load_arrays(arrays | {"physics.mean": np.zeros(2)})
    with pytest.raises(InputError, match="name the plant"):
        model.load_arrays(arrays | {"physics.mean": np.full(5, np.nan)})


def test_the_plant_of_a_task_is_the_one_with_its_names(task):
    assert Model(ModelConfig(mean="physics"), task).physics.plant.name == cart_pole().name
    strange = dataclasses.replace(task, input_names=("push",))
    with pytest.raises(InputError, match="register one"):
        Model(ModelConfig(mean="physics"), strange)
    with pytest.raises(InputError, match="There is no plant 'other'"):
        Model(ModelConfig(mean="physics", plant=PLANT | {"plant": "other"}), task)
