from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter1d

from mcpilco.files import read_groups, write_groups
from mcpilco.gp import GP
from mcpilco.identification.inverse_dynamics import (
    ESTIMATORS,
    fit_inverse_dynamics,
    load_inverse_dynamics,
    save_inverse_dynamics,
)
from mcpilco.identification.inverse_dynamics.estimators import GEOMETRIES
from mcpilco.identification.inverse_dynamics.gaussian import STRETCHES, left_out_error
from mcpilco.kernels import RBF
from mcpilco.typing import InputError, RunFolderError
from tests.mcpilco.identification.inverse_dynamics.robots import measured, moved, random_robot

TWO = ("hinge", "slide")


@pytest.fixture(scope="module")
def robot():
    return random_robot(TWO, np.random.default_rng(0))


@pytest.fixture(scope="module")
def data(robot):
    return measured(robot, np.random.default_rng(1), 150, noise=0.02)


@pytest.fixture(scope="module")
def models(robot, data):
    return {
        name: fit_inverse_dynamics(data, name, chain=robot, tuned_on=100) for name in ESTIMATORS
    }


@pytest.mark.parametrize(
    "kinds",
    [
        pytest.param(TWO, marks=pytest.mark.slow),
        ("slide", "hinge"),
        pytest.param(("hinge", "hinge"), marks=pytest.mark.slow),
    ],
)
def test_gip_reproduces_a_random_robot_of_which_it_knows_the_kinds_of_joints_alone(kinds):
    rng = np.random.default_rng(3)
    robot = random_robot(kinds, rng)
    model = fit_inverse_dynamics(measured(robot, rng, 400), "gip", friction=False, tuned_on=200)
    assert model.nmse(measured(robot, rng, 200)).max() < 1e-6


@pytest.mark.claim
@pytest.mark.slow
def test_gip_reproduces_a_random_robot_of_three_joints():
    rng = np.random.default_rng(5)
    robot = random_robot(("hinge", "slide", "hinge"), rng)
    model = fit_inverse_dynamics(measured(robot, rng, 1500), "gip", friction=False)
    assert model.nmse(measured(robot, rng, 500)).max() < 1e-6


@pytest.mark.parametrize("name", ["fe", "pp"])
def test_estimators_with_the_true_geometry_reproduce_a_robot(name):
    rng = np.random.default_rng(4)
    robot = random_robot(TWO, rng)
    model = fit_inverse_dynamics(measured(robot, rng, 150), name, chain=robot, friction=False)
    assert model.nmse(measured(robot, rng, 100)).max() < 1e-6


@pytest.mark.slow
def test_friction_is_learned_where_it_is_allowed(robot):
    rng = np.random.default_rng(6)
    train, test = (measured(robot, rng, 300, friction=2.0) for _ in range(2))
    told, untold = (
        fit_inverse_dynamics(train, "gip", friction=allowed, tuned_on=150).nmse(test)
        for allowed in (True, False)
    )
    assert told.max() < 1e-5
    assert (untold > 1e-3).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_forces_that_no_motion_explains_are_not_interpolated(seed):
    """They are smooth in time, as those of a joint that sticks or of filtered torques."""
    rng = np.random.default_rng(seed)
    robot = random_robot(("hinge", "hinge"), rng)
    told, test = (moved(robot, rng, 1000) for _ in range(2))
    smooth = gaussian_filter1d(rng.normal(size=told.tau.shape), 8, axis=0)
    told = replace(told, tau=told.tau + 0.15 * told.tau.std(0) * smooth / smooth.std(0))
    model = fit_inverse_dynamics(told, "gip", friction=False, tuned_on=200)
    assert model.nmse(test).max() < 0.15


def test_the_left_out_error_is_that_of_processes_that_never_saw_the_stretch():
    rng = np.random.default_rng(0)
    X, noise = torch.as_tensor(rng.normal(size=(60, 2))), 0.1 * rng.normal(size=(60, 1))
    y = X[:, :1].sin() + torch.as_tensor(noise)
    gp = GP(RBF(2, (1,)), noise_std=0.2)
    errors = []
    for left in np.array_split(np.arange(60), STRETCHES):
        others = np.setdiff1d(np.arange(60), left)
        errors.append(gp.condition(X[others], y[others]).mean(X[left]) - y[left])
    expected = float(torch.cat(errors).square().mean())
    assert left_out_error(gp.condition(X, y)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_knowing_the_kinds_of_joints_is_better_than_knowing_nothing(robot, models):
    test = measured(robot, np.random.default_rng(2), 200)
    assert (models["gip"].nmse(test) < 0.1 * models["rbf"].nmse(test)).all()


def test_torques_of_any_batch_are_those_of_the_rows(models, data):
    motion = data.motion[:6]
    for model in models.values():
        tau = model(motion.reshape(3, 1, 2, -1))
        assert tau.shape == (3, 1, 2, 2)
        torch.testing.assert_close(tau.reshape(6, 2), model(motion), rtol=1e-9, atol=1e-9)


def test_torques_are_differentiable_by_the_motion(models):
    motion = torch.randn(2, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for model in models.values():  # weights of samples are large, so small steps lose digits
        assert torch.autograd.gradcheck(model, motion.requires_grad_(), eps=1e-4, atol=1e-3)


def test_a_saved_model_is_the_model(models, data, tmp_path):
    motion = data.motion[:20]
    for name, model in models.items():
        again = load_inverse_dynamics(save_inverse_dynamics(tmp_path / f"{name}.npz", model))
        torch.testing.assert_close(again(motion), model(motion), rtol=1e-8, atol=1e-8)
        assert again.fitted == model.fitted


def test_a_damaged_model_is_refused(models, tmp_path):
    about, groups = read_groups(save_inverse_dynamics(tmp_path / "m.npz", models["gip"]))
    del groups["joint_joint1"]
    write_groups(tmp_path / "m.npz", about, groups)
    with pytest.raises(RunFolderError, match=r"no model of inverse dynamics.*fit it again"):
        load_inverse_dynamics(tmp_path / "m.npz")


def test_spread_of_a_prediction_grows_away_from_the_data(models, data):
    near, far = data.motion[:10], data.motion[:10] + 20.0
    model = models["rbf"]
    assert (model.std(near) < model.std(far)).all()


@pytest.mark.slow
def test_equal_seeds_give_equal_models(robot, data):
    for name in ("rbf", "nn"):
        first, again, other = (
            fit_inverse_dynamics(data, name, tuned_on=60, seed=seed) for seed in (0, 0, 1)
        )
        tau = [model(data.motion).detach() for model in (first, again, other)]
        assert torch.equal(tau[0], tau[1])
        assert not torch.equal(tau[0], tau[2])


def test_what_the_data_do_not_determine_is_named(models):
    assert "body0_m" in models["fe"].report.unidentified
    assert all(model.report.iterations > 0 for name, model in models.items() if name != "fe")
    assert len(models["gip"].report.evidence) == 2


def test_an_unexcited_joint_is_reported(robot):
    noisy = measured(robot, np.random.default_rng(7), 150, noise=500.0)
    warnings = fit_inverse_dynamics(noisy, "gip", tuned_on=100).report.warnings
    assert any("is taken for noise; record faster or larger motions" in line for line in warnings)


@pytest.mark.parametrize("name", GEOMETRIES)
def test_a_missing_or_wrong_geometry_is_refused(data, name):
    with pytest.raises(InputError, match="needs the robot's geometry"):
        fit_inverse_dynamics(data, name)
    other = random_robot(("slide", "slide"), np.random.default_rng(0))
    with pytest.raises(InputError, match="give the chain of this robot"):
        fit_inverse_dynamics(data, name, chain=other)


@pytest.mark.usefixtures("unchecked_shapes")
def test_an_unknown_estimator_is_refused(data):
    with pytest.raises(InputError, match="kernel must be one of fe, pp, sp, gip, rbf, nn"):
        fit_inverse_dynamics(data, "gpi")
