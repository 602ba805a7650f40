"""Identified base parameters become numbers of a plant that no noise can make negative."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import envs
from mcpilco.agent import Model
from mcpilco.config import ModelConfig
from mcpilco.identification import RigidBody, correction_of_identified, identify, theta_of
from mcpilco.mjcf import chain_of, mjcf_of, plant_of_text
from mcpilco.plant import correction_json
from mcpilco.typing import InputError
from tests.mcpilco.identification.rigid_body.log import segment

PLANT = envs.PLANTS["mcpilco/DoublePendulum-v0"]()
TRUE = PLANT.where(
    upper_mass=0.7, lower_mass=0.3, lower_center=0.6, upper_inertia=0.1, shoulder_friction=0.05
)


def model_of(plant) -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_string(mjcf_of(plant.chain, []))
    model.dof_damping[:] = [plant.values[f"{j}_friction"] for j in plant.layout.joints]
    return model


@pytest.fixture(scope="module")
def found():
    log = segment(model_of(TRUE), noise=1e-4, force_noise=0.02)
    return identify(model_of(PLANT), [log], terms=("viscous",))


@pytest.mark.parametrize("name", [n for n in envs.PLANTS if "Pendulum-v0" not in n])
def test_an_mjcf_of_a_chain_is_the_chain(name):
    plant = envs.PLANTS[name]()
    again = chain_of(mujoco.MjModel.from_xml_string(mjcf_of(plant.chain, [])))
    assert again.joints == plant.chain.joints
    for body, link in zip(again.bodies, plant.chain.bodies, strict=True):
        for what in ("mass", "center", "inertia", "origin", "axis", "rotation"):
            np.testing.assert_allclose(getattr(body, what), getattr(link, what), atol=1e-6)


def test_a_plant_gets_what_forces_tell_with_its_joint_distribution(found):
    correction = correction_of_identified(PLANT, found)
    (member,) = correction.spread
    plant = PLANT.where(**correction.parameters)
    there, wanted = (found.base.of(theta_of(p, found.body)) for p in (plant, TRUE))
    error = there - wanted
    std = np.sqrt(np.diag(found.covariance)) + 2e-3 * np.abs(wanted)
    assert (np.abs(error) < 6 * std + 1e-6).all()
    # lengths between joints, gains and gravity are no matter of forces
    assert not {"upper_length", "shoulder_gain", "gravity"} & member.std.keys()
    # a mass alone is not told, its first moment is
    names, correlation = list(member.std), np.array(member.correlation)
    logs = np.array([member.std[n] / member.values[n] for n in names])
    moment = np.isin(names, ["lower_mass", "lower_center", "lower_length"]).astype(float)
    covariance = correlation * np.outer(logs, logs)
    assert moment @ covariance @ moment < 0.01
    assert logs[names.index("lower_mass")] > 0.05


def test_what_noise_made_negative_is_positive_in_the_plant(found):
    negative = found.beta - 2.0 * np.abs(found.beta) * (np.arange(len(found.beta)) == 2)
    assert negative[2] < 0.0
    wrong = replace(found, beta=negative)
    correction = correction_of_identified(PLANT, wrong)
    assert min(correction.parameters.values()) > 0.0
    (member,) = correction.spread
    assert np.linalg.eigvalsh(np.array(member.correlation)).min() > -1e-9


def test_the_physics_mean_begins_with_that_distribution(found):
    described = correction_json(correction_of_identified(PLANT, found))
    config = ModelConfig(kernel="rbf", mean="physics", plant=described, uncertainty="told")
    task = envs.SwingUp(
        plant=PLANT, input_limit=1.0, dt=0.05, start_std=0.01, noise_std=0.01, cost=len
    ).task
    physics = Model(config, task).physics
    (member,) = correction_of_identified(PLANT, found).spread
    assert set(physics.names) == set(member.std)
    order = [list(member.std).index(name) for name in physics.names]
    logs = np.array([member.std[n] / member.values[n] for n in physics.names])
    correlation = np.array(member.correlation)[np.ix_(order, order)]
    covariance = correlation * np.outer(logs, logs)
    np.testing.assert_allclose(physics.belief.covariance, covariance, atol=1e-12)
    with pytest.raises(InputError, match='"told" where the plant has a spread'):
        ModelConfig(kernel="rbf", mean="physics", uncertainty="told")


def test_a_plant_can_be_given_as_an_mjcf():
    motors = [("a", 0, 2.0), ("b", 1, 1.0)]
    plant = plant_of_text(mjcf_of(TRUE.chain, motors), "arm")
    assert plant.name == "arm"
    assert plant.gains == [2.0, 1.0]
    assert plant.layout.states[0] == "shoulder_position"
    body = RigidBody.of(model_of(TRUE), ("viscous",))
    frictionless = theta_of(plant, body).reshape(2, -1)[:, :10]
    np.testing.assert_allclose(frictionless, body.nominal.reshape(2, -1)[:, :10], atol=1e-6)


def test_the_dry_friction_of_an_mjcf_is_the_term_that_is_identified():
    """MuJoCo's, which is soft, is no other one beside it."""
    motors = [("a", 0, 2.0), ("b", 1, 1.0)]
    rubbed = mjcf_of(TRUE.chain, motors).replace("<joint ", '<joint frictionloss="0.3" ')
    plant = plant_of_text(rubbed, "arm")
    body = RigidBody.of(model_of(TRUE), ("coulomb",))
    np.testing.assert_array_equal(theta_of(plant, body).reshape(2, -1)[:, -1], 0.3)


def test_a_plant_with_other_joints_is_refused(found):
    with pytest.raises(InputError, match="must have the joints shoulder, elbow, got cart, pole"):
        correction_of_identified(envs.PLANTS["mcpilco/CartPoleSwingUp-v0"](), found)
