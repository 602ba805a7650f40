"""A corrected model with its module moves in plain MuJoCo as the corrected plant does."""

from __future__ import annotations

import importlib.util
import json

import mujoco
import numpy as np
import pytest

from mcpilco.mjcf import write_corrected_mjcf
from mcpilco.plant import CATALOGUE, EffectInstance, correction_of
from tests.mcpilco.mjcf.mujoco.models import MODELS, plant_of_text
from tests.mcpilco.mjcf.mujoco.test_plant import DT, commands

CASES = [
    ("hopper", "viscous_friction", "knee", [0.1], False),
    ("hopper", "coulomb_friction", "hip", [0.3, 0.01], False),
    ("hopper", "stribeck_friction", "hip", [0.3, 0.2, 0.5, 0.05], True),
    ("hopper", "asymmetric_viscous_friction", "knee", [0.05, 0.02], True),
    ("hopper", "load_dependent_friction", "hip", [0.1, 0.05], True),
    ("hopper", "spring", "knee", [2.0], False),
    ("hopper", "position_ripple", "knee", [0.5, 0.3, 6.0], True),
    ("hopper", "body_mass", "thigh", [0.1234567], False),
    ("hopper", "center_of_mass", "shank", [0.0123456], False),
    ("hopper", "body_length", "thigh", [0.0123456], False),
    ("hopper", "armature", "knee", [0.00123456], False),
    ("hopper", "actuator_gain", "hip_servo", [0.8], False),
    ("hopper", "actuator_saturation", "hip_servo", [4.0], False),
    ("hopper", "actuator_delay", "hip_servo", [0.0123], True),
    ("hopper", "actuator_lag", "knee_motor", [0.03], True),
    ("hopper", "actuator_rate_limit", "knee_motor", [60.0], True),
    ("hopper", "actuator_dead_zone", "knee_motor", [1.0], True),
    ("hopper", "backlash", "knee_motor", [0.7], True),
    ("hopper", "contact_friction", "ground", [0.4], False),
    ("hopper", "contact_stiffness", "ground", [0.3], False),
    ("hopper", "contact_damping", "ground", [0.6], False),
    ("hopper", "ground_height", "ground", [-0.0123456], False),
    ("loop", "stribeck_friction", "a", [0.03, 0.02, 0.5, 0.05], True),
    ("loop", "actuator_lag", "actuator", [0.013], True),
    ("loop", "hardening_spring", "b", [0.5], False),
    ("box", "actuator_delay", "actuator", [0.013], True),
]


@pytest.mark.one_in(3)
@pytest.mark.parametrize(("name", "effect", "target", "values", "module"), CASES)
def test_a_corrected_model_moves_as_its_plant(name, effect, target, values, module, tmp_path):
    plant = plant_of_text(MODELS[name], "high" if name == "hopper" else "")
    source, path = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    source.write_text(MODELS[name])
    changed = plant.having([(EffectInstance(CATALOGUE[effect], target), values)])
    told = write_corrected_mjcf(source, correction_of(changed, plant), path, plant)
    assert path.with_suffix(".py").exists() == module == bool(told)
    u = commands(plant, 4)
    model = mujoco.MjModel.from_xml_path(str(path))
    if module:
        imported(path.with_suffix(".py")).install(model)
    try:
        found = stepped(plant, model, u)
    finally:
        mujoco.set_mjcb_control(None)
    expected = changed.simulate(plant.rest[None], u[None], DT)[0]
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert np.abs(expected - plant.simulate(plant.rest[None], u[None], DT)[0]).max() > 1e-3


def imported(path):
    spec = importlib.util.spec_from_file_location("corrected", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def stepped(plant, model, u):
    """A plain loop of mj_step, in which a user writes a command when it changes, and looks on."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = plant.coordinates.qpos(plant.rest[0::2]), plant.rest[1::2]
    found = [plant.rest]
    for k, command in enumerate(u):
        if k == 0 or not np.array_equal(command, u[k - 1]):
            data.ctrl[:] = command
        for _ in range(round(DT / model.opt.timestep)):
            mujoco.mj_step(model, data)
        q = plant.coordinates.positions(data.qpos.copy())
        found.append(np.stack([q, data.qvel], axis=1).ravel())
    return np.array(found)


def test_a_callback_begins_anew_with_its_data_and_knows_its_model(tmp_path):
    plant = plant_of_text(MODELS["hopper"])
    late = plant.having([(EffectInstance(CATALOGUE["actuator_lag"], "knee_motor"), [0.05])])
    source, path = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    source.write_text(MODELS["hopper"])
    write_corrected_mjcf(source, correction_of(late, plant), path, plant)
    model, u = mujoco.MjModel.from_xml_path(str(path)), commands(plant, 4)
    other = mujoco.MjModel.from_xml_string(MODELS["box"])
    imported(path.with_suffix(".py")).install(model)
    try:
        first, again = stepped(plant, model, u), stepped(plant, model, u)
        np.testing.assert_array_equal(first, again)
        data = mujoco.MjData(other)
        data.ctrl[:] = 0.7
        mujoco.mj_step(other, data)
        assert data.ctrl[0] == 0.7
    finally:
        mujoco.set_mjcb_control(None)


def test_what_a_sensor_does_is_told_and_in_no_module(tmp_path):
    plant = plant_of_text(MODELS["hopper"])
    offset = EffectInstance(CATALOGUE["sensor_offset"], "hip_position")
    source, path = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    source.write_text(MODELS["hopper"])
    correction = correction_of(plant.having([(offset, [0.1])]), plant)
    told = write_corrected_mjcf(source, correction, path, plant)
    assert "apply it to what is measured" in told[0]
    assert not path.with_suffix(".py").exists()
    assert json.dumps(correction.effects[0].parameters) == '{"o": 0.1}'
