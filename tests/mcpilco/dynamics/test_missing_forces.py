"""Forces that a plant's equations lack are found, and make them those of the true plant."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from envs.plants import cart_pole, double_pendulum
from mcpilco.agent import Model
from mcpilco.config import ModelConfig
from mcpilco.data import Transitions
from mcpilco.dynamics.dynamics import speed_integration
from mcpilco.dynamics.missing_forces import MissingForces
from mcpilco.dynamics.physics import PhysicsMean
from mcpilco.plant import system_of
from mcpilco.plant.equations.chain import inverse_dynamics
from mcpilco.typing import InputError
from tests.mcpilco.dynamics.test_physics import NOISE, PLANT, simulated
from tests.mcpilco.plant.equations.test_step import task_of

WRONG = {"cart_mass": 0.65, "pole_mass": 0.4, "pole_length": 0.55, "cart_friction": 0.0}


def model_of(task, parameters=WRONG, **how) -> Model:
    plant = PLANT | {"parameters": parameters}
    return Model(ModelConfig(kernel="gip+rbf", mean="physics", plant=plant, **how), task)


def forces_of(plant, motion):
    """What the motions [q, q', q''] of a plant take, friction included [N, N m]."""
    system = system_of(plant.tables(plant.nominal[None]), {})
    found = []
    for q, v, a in motion.tolist():
        tau = np.array(inverse_dynamics(system, q, v, a, system.gravity))
        for effect, j, constants in system.laws:
            tau[j] -= effect.force(q[j], v[j], *constants)
        found.append(tau)
    return np.array(found)


def learned_forces(physics, motion):
    """The nominal plant's forces, and those that it lacks."""
    weights = (physics.belief.mean[len(physics.free) :] * physics.missing.scales).tolist()
    missing = []
    for q, v, a in motion.tolist():
        R, s = physics.missing.forces(q, v, weights)
        missing.append(np.array(R) @ a + s)
    return forces_of(physics.plant, motion) + np.array(missing)


def test_the_forces_found_make_inverse_dynamics_those_of_the_true_plant():
    true, rng = double_pendulum(), np.random.default_rng(3)
    known = [p for p in true.parameters if p.uncertain and not p.name.endswith("gain")]
    wrong = true.where(**{p.name: 1.2 * p.value for p in known})
    task = dataclasses.replace(task_of(true), dt=0.02, velocities=((0, 1), (2, 3)))
    states, inputs = 2.0 * rng.normal(size=(200, 4)), rng.uniform(-0.5, 0.5, (200, 1, 2))
    rows = Transitions(states, inputs[:, 0], true.simulate(states, inputs, task.dt)[:, -1])
    law = speed_integration(task)
    physics = PhysicsMean(wrong, task, law, uncertainty=0.0, longest=0.01, missing=True)
    physics.identify(rows, 1e-4)
    motion = rng.normal(size=(50, 3, 2)) * [[2.0], [2.0], [10.0]]
    expected, nominal = forces_of(true, motion), forces_of(wrong, motion)
    error = np.abs(learned_forces(physics, motion) - expected).mean(0)
    assert (error < 0.05 * np.abs(nominal - expected).mean(0)).all()


def test_what_is_missing_is_predicted_where_parameters_are_trusted(task):
    rows = simulated(task, samples=100, noise=NOISE)
    fresh = simulated(task, samples=100, seed=9)
    model = model_of(task, uncertainty=0.0)
    before = model.physics.residuals(fresh).std(0)
    model.fit(rows)
    assert (model.physics.residuals(fresh).std(0) < 0.2 * before).all()


def test_of_a_plant_that_lacks_nothing_nothing_is_changed(task):
    rows = simulated(task, noise=NOISE)
    model = model_of(task, {})
    model.fit(rows)
    known = Model(dataclasses.replace(model.config, kernel="rbf"), task)
    known.fit(rows)
    assert model.physics.missing.forces is None
    for mine, its in zip(model.rows(rows), known.rows(rows), strict=True):
        torch.testing.assert_close(mine, its, rtol=0, atol=0)


def test_a_sample_of_the_forces_is_kept_and_agrees_with_the_data(task):
    rows = simulated(task, noise=NOISE)
    model = model_of(task, uncertainty=0.0)
    model.fit(rows)
    drawn = model.dynamics(rows).draw(200, torch.Generator().manual_seed(0))
    assert len(drawn.numbers.unique(dim=0)) > 1
    none = torch.zeros(200, 2).double()

    def spread(state, force):
        states = torch.tensor(state).double().expand(200, -1)
        inputs = torch.full((200, 1), force).double()
        first, again = (drawn.step(states, inputs, none) for _ in range(2))
        torch.testing.assert_close(first, again, rtol=0, atol=0)
        return first.std(0)[[1, 3]]

    here = spread(rows.states[0].tolist(), float(rows.inputs[0, 0]))
    assert (here < 3 * NOISE).all()
    assert spread([0.0, 0.0, 0.3, 25.0], 40.0).max() > 2 * here.max()


@pytest.mark.slow
def test_what_was_found_is_read_back(task):
    rows = simulated(task, noise=NOISE)
    model = model_of(task, uncertainty=0.0)
    model.fit(rows)
    assert model.physics.missing.forces is not None
    arrays, again = model.to_arrays(), model_of(task, uncertainty=0.0)
    again.load_arrays(arrays)
    for mine, its in zip(model.rows(rows), again.rows(rows), strict=True):
        torch.testing.assert_close(mine, its, rtol=0, atol=0)
    for name in ("physics.roots", "physics.mean"):
        with pytest.raises(InputError, match="name the plant"):
            again.load_arrays(arrays | {name: np.zeros((1, 2))})


def test_too_many_joints_are_refused():
    layout = dataclasses.replace(
        cart_pole().layout,
        slides=(False,) * 3,
        states=tuple(f"{j}_{kind}" for j in "abc" for kind in ("angle", "velocity")),
    )
    plant = dataclasses.replace(cart_pole(), layout=layout)
    with pytest.raises(InputError, match="gip is for few joints"):
        MissingForces(plant, task_of(plant))
