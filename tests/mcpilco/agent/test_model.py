"""Laws of the agent's model: it learns what generated the data, from scratch each time."""

from __future__ import annotations

import dataclasses
import functools
import operator

import numpy as np
import pytest
import torch

from mcpilco.agent.model import Model, make_kernel
from mcpilco.config import ModelConfig
from mcpilco.data import Transitions
from mcpilco.gp import GP
from mcpilco.task import TaskSpec
from mcpilco.typing import NotPositiveDefiniteError


def some_data(task: TaskSpec, count: int = 30, seed: int = 0, noise: float = 0.01) -> Transitions:
    """A damped pendulum on a cart of its own: smooth, and nearly constant acceleration."""
    rng = np.random.default_rng(seed)
    states = rng.uniform(-1.5, 1.5, (count, 4))
    inputs = rng.uniform(-2, 2, (count, 1))
    _, dx, angle, omega = states.T
    changes = np.stack([inputs[:, 0] - 0.3 * dx, -4 * np.sin(angle) + inputs[:, 0] - omega], -1)
    speeds = states[:, [1, 3]] + task.dt * changes
    positions = states[:, [0, 2]] + task.dt * (states[:, [1, 3]] + speeds) / 2
    following = np.stack([positions[:, 0], speeds[:, 0], positions[:, 1], speeds[:, 1]], -1)
    return Transitions(states, inputs, following + noise * rng.standard_normal((count, 4)))


@pytest.mark.parametrize(
    ("kernel", "terms"), [("rbf", ["RBF"]), ("mpk", ["MPK"]), ("rbf+mpk", ["RBF", "MPK"])]
)
def test_a_kernel_is_the_sum_of_what_it_is_called(kernel: str, terms: list[str]) -> None:
    made = make_kernel(ModelConfig(kernel=kernel), width=3, outputs=2)
    parts = [type(part).__name__ for part in made.modules() if type(part).__name__ in terms]
    assert parts == terms
    assert (made.width, made.batch) == (3, (2,))


def with_two_inputs(task: TaskSpec) -> TaskSpec:
    return dataclasses.replace(task, input_names=("force", "torque"), input_units=("N", "N m"))


def test_a_series_sees_all_lags_of_one_input_and_then_those_of_the_next(task: TaskSpec) -> None:
    model = Model(ModelConfig(kernel="rbf+sed-mpk", memory=2), with_two_inputs(task))
    newest_first = [[4.0, 5.0, 6.0, 7.0]]  # force and torque of one step ago, then of two
    state = np.concatenate([np.zeros((1, 4)), newest_first], 1)
    X, _ = model.rows(Transitions(state, np.array([[2.0, 3.0]]), state))
    series = model.gp.kernel.parts[1]
    assert X[0, series.dims].tolist() == [2.0, 4.0, 6.0, 3.0, 5.0, 7.0]
    assert series.kernel.channels == 2


def test_a_filter_is_affine_in_present_and_past_inputs(task: TaskSpec) -> None:
    model, data = Model(ModelConfig(kernel="sed-fir", memory=2), task), some_data(task, 9)
    past = np.random.default_rng(1).normal(size=(10, 2))
    states = np.concatenate([data.states, past[:-1]], 1)
    rows = Transitions(states, data.inputs, np.concatenate([data.next_states, past[1:]], 1))
    posterior = model.dynamics(rows).posterior
    change = torch.zeros(model.gp.kernel.width, dtype=torch.float64)
    change[model._lags()[0]] = torch.tensor([1.0, -0.5, 2.0], dtype=torch.float64)
    at = posterior.X[:1] + torch.arange(3.0)[:, None] * change
    mean, _ = posterior.mean_and_variance(at)
    torch.testing.assert_close(mean[0] + mean[2], 2 * mean[1])
    aside, _ = posterior.mean_and_variance(at + 1.0 * (change == 0))
    assert not torch.allclose(aside[1] - aside[0], mean[1] - mean[0])


@pytest.mark.parametrize(
    ("integration", "names"),
    [
        ("speed", ("cart_velocity", "pole_velocity")),
        ("full", ("cart_position", "cart_velocity", "pole_angle", "pole_velocity")),
    ],
)
def test_there_is_a_gp_for_each_predicted_state(task: TaskSpec, integration: str, names) -> None:
    model = Model(ModelConfig(integration=integration), task)
    assert model.names == model.gp.names == names
    X, Y = model.rows(some_data(task, 7))
    assert (X.shape, Y.shape) == ((7, 6), (7, len(names)))


@pytest.mark.parametrize("integration", ["speed", "full"])
def test_the_model_predicts_what_it_has_not_seen(task: TaskSpec, integration: str) -> None:
    model = Model(ModelConfig(integration=integration), task)
    seen, unseen = some_data(task, 60), some_data(task, 40, seed=1, noise=0.0)
    values = model.fit(seen)
    dynamics = model.dynamics(seen)
    states, inputs = torch.from_numpy(unseen.states), torch.from_numpy(unseen.inputs)
    still = torch.zeros(40, dynamics.noise_dim, dtype=torch.float64)
    error = dynamics.step(states, inputs, still).numpy() - unseen.next_states
    change = np.abs(unseen.next_states - unseen.states).max(0)
    assert (np.sqrt((error**2).mean(0)) < 0.1 * change).all()
    assert values["model/samples"] == 60


def test_the_numbers_of_a_fit_are_those_of_the_gps(task: TaskSpec) -> None:
    model, data = Model(ModelConfig(), task), some_data(task)
    values = model.fit(data)
    with torch.no_grad():
        nlml = model.gp.nlml(*model.rows(data))
    for i in range(2):
        assert values[f"model/nlml_{i}"] == pytest.approx(float(nlml[i]), rel=1e-12)
        assert values[f"model/noise_std_{i}"] == model.noise_std[i]
        assert 0.01 <= model.noise_std[i] < 0.05


def test_each_fit_starts_from_scratch(task: TaskSpec) -> None:
    first, second = some_data(task, 20), some_data(task, 30, seed=1)
    experienced, fresh = Model(ModelConfig(), task), Model(ModelConfig(), task)
    experienced.fit(first)
    assert experienced.fit(second) == fresh.fit(second)
    for name, array in fresh.gp.to_arrays().items():
        np.testing.assert_array_equal(experienced.gp.to_arrays()[name], array)


@pytest.mark.parametrize(("optimiser", "least", "most"), [("lbfgs", 1, 200), ("adam", 500, 1500)])
def test_each_optimiser_has_the_steps_it_needs(
    task: TaskSpec, monkeypatch: pytest.MonkeyPatch, optimiser: str, least: int, most: int
) -> None:
    asked = {}
    fit = GP.fit

    def spy(gp: GP, *data, **kwargs):
        asked.update(kwargs)
        return fit(gp, *data, **{**kwargs, "max_iterations": 3})

    monkeypatch.setattr(GP, "fit", spy)
    Model(ModelConfig(optimiser=optimiser), task).fit(some_data(task, 5))
    assert asked["optimiser"] == optimiser
    assert least <= asked["max_iterations"] <= most


def test_a_subset_of_repeated_data_predicts_the_same(task: TaskSpec) -> None:
    data = some_data(task, 12)
    repeated = functools.reduce(operator.add, [data] * 10)
    steps = []
    for threshold in (0.5, None):
        model = Model(ModelConfig(kernel="rbf", subset_threshold=threshold), task)
        model.fit(repeated)
        dynamics = model.dynamics(repeated)
        steps.append(len(dynamics.posterior.X))
        states, inputs = torch.from_numpy(data.states), torch.from_numpy(data.inputs)
        steps.append(dynamics.step(states, inputs, torch.zeros(12, 2, dtype=torch.float64)))
    kept, few, count, all_rows = steps
    assert count == 120
    assert 12 <= kept <= 60
    torch.testing.assert_close(few, all_rows, atol=0.02, rtol=0)


def test_many_samples_are_known_through_few(task: TaskSpec) -> None:
    data = some_data(task, 60)
    predicted = []
    for inducing in (20, 40):
        model = Model(ModelConfig(kernel="rbf", inducing=inducing), task)
        values = model.fit(data)
        dynamics = model.dynamics(data)
        assert values["model/samples"] == 60
        few = inducing == 20
        assert values.get("model/fitted_samples") == (40 if few else None)
        assert len(dynamics.posterior.X) == (20 if few else 60)
        states, inputs = torch.from_numpy(data.states), torch.from_numpy(data.inputs)
        predicted.append(dynamics.step(states, inputs, torch.zeros(60, 2, dtype=torch.float64)))
    following = torch.from_numpy(data.next_states)
    errors = [float((there - following).square().mean()) for there in predicted]
    assert errors[0] < 2 * errors[1] + 1e-4


def test_a_subset_that_was_asked_for_is_told_as_one(task: TaskSpec) -> None:
    data = some_data(task, 60)
    model = Model(ModelConfig(kernel="rbf", inducing=20, subset_threshold=0.5), task)
    values = model.fit(data)
    assert values["model/fitted_samples"] == 40
    assert values["model/posterior_samples"] == len(model.dynamics(data).posterior.X)
    assert "model/inducing_points" not in values


def test_bounds_are_a_multiple_of_the_largest_state_seen(task: TaskSpec) -> None:
    model = Model(ModelConfig(plausible=3.0), task)
    data = some_data(task)
    recorded = np.abs(np.concatenate([data.states, data.next_states])).max(0)
    np.testing.assert_allclose(model.dynamics(data).bounds, 3.0 * recorded[[1, 3]])
    little = Transitions(1e-3 * data.states, data.inputs, 1e-3 * data.next_states)
    np.testing.assert_allclose(model.dynamics(little).bounds, [0.3, 0.3])  # the spread at the start


def test_a_state_that_never_moved_bounds_nothing(task: TaskSpec) -> None:
    data = some_data(task)
    still = np.array([1.0, 1.0, 1.0, 0.0])
    data = Transitions(still * data.states, data.inputs, still * data.next_states)
    model = Model(ModelConfig(), dataclasses.replace(task, start_std=(0.0,) * 4))
    bounds = model.dynamics(data).bounds
    assert bounds[0] < np.inf
    assert bounds[1] == np.inf


def test_a_gp_that_cannot_be_factorised_is_named(task: TaskSpec) -> None:
    model, data = Model(ModelConfig(kernel="rbf"), task), some_data(task)
    with torch.no_grad():
        for parameter in model.gp.kernel.parameters():
            parameter[1] = float("nan")
    with pytest.raises(NotPositiveDefiniteError, match="covariance matrix of pole_velocity"):
        model.dynamics(data)


RBF_ALONE = ModelConfig(kernel="rbf")


def pushed_aside(data: Transitions) -> Transitions:
    """The same motion, of an input that had an offset: no law that a mirror leaves as it is."""
    return dataclasses.replace(data, inputs=data.inputs + 1.0)


def test_images_count_where_a_system_is_its_own_mirror_image(task: TaskSpec) -> None:
    model, data = Model(RBF_ALONE, task), some_data(task, 25)
    model.fit(data)
    assert model.mirrored
    dynamics, still = model.dynamics(data), torch.zeros(40, 2, dtype=torch.float64)
    unseen = some_data(task, 40, seed=1)
    states, inputs = torch.from_numpy(unseen.states), torch.from_numpy(unseen.inputs)
    there, image = dynamics.step(states, inputs, still), dynamics.step(-states, -inputs, still)
    torch.testing.assert_close(there, -image, rtol=0, atol=1e-6)


def test_images_do_not_count_against_the_evidence(task: TaskSpec) -> None:
    data = pushed_aside(some_data(task, 25))
    asked, never = Model(RBF_ALONE, task), Model(dataclasses.replace(RBF_ALONE, mirror=0), task)
    assert asked.fit(data) == never.fit(data)
    assert not asked.mirrored
    assert asked.known(data) is data


def test_many_samples_have_no_images(task: TaskSpec) -> None:
    model, few, many = (
        Model(dataclasses.replace(RBF_ALONE, mirror=30), task),
        some_data(task, 30),
        some_data(task, 31),
    )
    model.fit(few)
    assert len(model.known(few)) == 60
    assert model.known(many) is many
    model.fit(many)
    assert not model.mirrored


def test_a_model_remembers_whether_images_count(task: TaskSpec) -> None:
    model, data = Model(RBF_ALONE, task), some_data(task, 25)
    model.fit(data)
    other = Model(RBF_ALONE, task)
    other.load_arrays(model.to_arrays())
    assert len(other.known(data)) == 50
    other.load_arrays(Model(RBF_ALONE, task).to_arrays())
    assert other.known(data) is data
