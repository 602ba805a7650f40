"""A corrected MJCF file moves in plain MuJoCo as the corrected plant does."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mcpilco.corrected_mjcf import write_corrected_mjcf
from mcpilco.correction import Addition, Correction, corrected
from mcpilco.mjcf import plant_of
from mcpilco.typing import InputError

ROBOT = """
<mujoco model="robot">
  <compiler angle="degree"/>
  <option gravity="0 0 -9.82" integrator="RK4"><flag contact="disable" /></option>
  <worldbody>
    <body name="cart" pos="0.1 0 1">
      <joint name="rail" type="slide" axis="1 0 0" damping="0.3"/>
      <geom type="box" size="0.1 0.05 0.04" mass="0.6"/>
      <body name="upper" pos="0.02 0 -0.05" euler="0 10 0">
        <joint name="shoulder" axis="0 -1 0" pos="0 0 0.02" stiffness="0.3" springref="15"/>
        <geom type="capsule" fromto="0 0 0 0.03 0 -0.35" size="0.02" mass="0.4"/>
        <body name="tool" pos="0.02 0 -0.2" euler="0 40 0">
          <geom type="box" size="0.02 0.03 0.06" mass="0.1"/>
        </body>
        <body name="lower" pos="0 0 -0.35">
          <joint name="elbow" axis="0 -1 0" damping="0.02"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.3"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="push" joint="rail" gear="10" ctrlrange="-1 1"/>
    <motor name="bend" joint="elbow" gear="0.5"/>
  </actuator>
</mujoco>
"""
START = np.array([0.05, 0.3, 0.6, -1.0, -0.4, 2.0])
DT, STEPS = 0.02, 40
SMOOTH = [
    ("viscous_friction", "shoulder", {"b": 0.05}),
    ("quadratic_drag", "elbow", {"c": 0.02}),
    ("spring", "rail", {"k": 5.0}),
    ("spring", "shoulder", {"k": 0.5}),
    ("hardening_spring", "elbow", {"k_3": 0.5}),
    ("hardening_spring", "shoulder", {"k_3": 0.5}),
    ("constant_force", "rail", {"f_0": -0.7}),
    ("constant_force", "shoulder", {"f_0": 0.2}),
    ("constant_force", "elbow", {"f_0": 0.1}),
    ("armature", "elbow", {"I_a": 0.01}),
    ("body_mass", "cart", {"m_d": 0.1}),
    ("body_mass", "upper", {"m_d": -0.05}),
    ("center_of_mass", "upper", {"c_d": 0.03}),
    ("center_of_mass", "lower", {"c_d": -0.02}),
    ("body_inertia", "upper", {"I_d": 0.004}),
    ("body_inertia", "lower", {"I_d": 0.002}),
    ("body_inertia", "lower", {"I_d": -0.001}),
    ("actuator_gain", "push", {"k": 0.8}),
    ("actuator_gain", "push", {"k": 1.3}),
    ("actuator_saturation", "push", {"u_m": 4.0}),
    ("actuator_saturation", "bend", {"u_m": 0.2}),
]
"""that MJCF says exactly"""
SAID_OUTSIDE = [
    ("actuator_dead_zone", "push", {"d": 0.2}, "to the command"),
    ("backlash", "bend", {"p": 0.1}, "to the command"),
    ("stribeck_friction", "elbow", {"f_c": 0.1, "f_d": 0.1, "v_s": 0.1}, "qfrc_applied"),
    ("position_ripple", "elbow", {"s": 0.1, "c": 0.0, "n": 7.0}, "qfrc_applied"),
    ("sensor_offset", "rail_position", {"o": 0.1}, "to what is measured"),
    ("sensor_scale", "rail_position", {"k": 1.1}, "to what is measured"),
    ("sensor_delay", "elbow_velocity", {"d": 0.01}, "to what is measured"),
]


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT)
    return path


def correction(*effects, **parameters):
    return Correction("robot", parameters, tuple(Addition(*effect) for effect in effects))


def pushes(seed=0, hold=5):
    """Commands that jump now and then, beyond the range of the first."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-1, 1, (STEPS // hold, 2)), hold, axis=0)


def mujoco_motion(path, inputs, timestep, start=START):
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep = timestep
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start[0::2], start[1::2]
    motion = [start]
    for u in inputs:
        data.ctrl[:] = u
        for _ in range(round(DT / timestep)):
            mujoco.mj_step(model, data)
        motion.append(np.stack([data.qpos, data.qvel], axis=1).ravel())
    return np.array(motion)


def apart(source, fix, path, inputs, timestep=5e-4, start=START):
    """Largest distance between the motions of the two forms [m or rad, m/s or rad/s]."""
    expected = corrected(plant_of(source), fix).simulate(start[None], inputs[None], DT)[0]
    return np.abs(mujoco_motion(path, inputs, timestep, start) - expected).max()


def test_model_that_is_not_corrected_moves_as_its_plant(robot, tmp_path):
    fix = correction()
    assert write_corrected_mjcf(robot, fix, tmp_path / "corrected.xml") == []
    assert apart(robot, fix, tmp_path / "corrected.xml", pushes()) < 2e-4


@pytest.mark.parametrize("effect", SMOOTH, ids=lambda effect: f"{effect[0]}-{effect[1]}")
def test_both_forms_of_an_effect_move_alike(robot, tmp_path, effect):
    fix, path = correction(effect), tmp_path / "corrected.xml"
    assert write_corrected_mjcf(robot, fix, path) == []
    assert apart(robot, fix, path, pushes()) < 2e-4
    assert apart(robot, fix, robot, pushes()) > 2e-2  # the effect is felt
