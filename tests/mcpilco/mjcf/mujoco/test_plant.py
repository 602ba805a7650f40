"""A plant that MuJoCo simulates is MuJoCo, and effects are in it as their formulas say."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from mcpilco.mjcf import MujocoPlant, read_plant
from mcpilco.plant import CATALOGUE, EffectInstance
from mcpilco.typing import InputError
from tests.mcpilco.mjcf.mujoco.models import MODELS, plant_of_text

DT = 0.02
ARM = """
<mujoco model="arm">
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <body name="upper">
      <joint name="shoulder" axis="0 -1 0" damping="0.05" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.4" contype="0"/>
      <body name="lower" pos="0 0 -0.3">
        <joint name="elbow" axis="0 -1 0" damping="0.02" armature="0.01"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.3" contype="0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="lift" joint="shoulder" gear="3"/><motor name="bend" joint="elbow" gear="2"/>
  </actuator>
</mujoco>
"""


def commands(plant: MujocoPlant, count: int = 10, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-1, 1, (count, len(plant.layout.inputs))), 5, axis=0)


def stepped(plant: MujocoPlant, u: np.ndarray) -> np.ndarray:
    """The states of a plain loop of mj_step."""
    model, data = plant.model, mujoco.MjData(plant.model)
    data.qpos[:] = plant.coordinates.qpos(plant.rest[0::2])
    data.qvel[:] = plant.rest[1::2]
    found = [plant.rest]
    for command in u:
        data.ctrl[:] = command
        for _ in range(round(DT / model.opt.timestep)):
            mujoco.mj_step(model, data)
        q = plant.coordinates.positions(data.qpos.copy())
        found.append(np.stack([q, data.qvel], axis=1).ravel())
    return np.array(found)


@pytest.mark.parametrize("name", MODELS)
def test_without_effects_it_is_mj_step_to_the_last_bit(name):
    plant = plant_of_text(MODELS[name], "high" if name == "hopper" else "")
    u = commands(plant)
    found = plant.simulate(plant.rest[None], u[None], DT)[0]
    np.testing.assert_array_equal(found, stepped(plant, u))
    assert np.ptp(found, axis=0).max() > 0.1


@pytest.mark.one_in(3)
@pytest.mark.parametrize("name", MODELS)
def test_neutral_values_change_nothing(name):
    plant = plant_of_text(MODELS[name])
    u = commands(plant, 3)[None]
    before = plant.simulate(plant.rest[None], u, DT)
    for each in plant.candidates():
        found = plant.having([(each, each.effect.neutral)]).simulate(plant.rest[None], u, DT)
        np.testing.assert_allclose(found, before, atol=1e-9, err_msg=str(each))


@pytest.mark.parametrize(
    ("effect", "target", "values"),
    [
        ("viscous_friction", "elbow", [0.05]),
        ("quadratic_drag", "elbow", [0.02]),
        ("asymmetric_viscous_friction", "shoulder", [0.05, 0.2]),
        ("spring", "shoulder", [0.8]),
        ("hardening_spring", "elbow", [0.5]),
        ("constant_force", "elbow", [-0.3]),
        ("position_ripple", "elbow", [0.2, 0.1, 5.0]),
        ("body_mass", "lower", [0.1]),
        ("center_of_mass", "lower", [0.05]),
        ("body_inertia", "lower", [0.0003]),
        ("armature", "shoulder", [0.02]),
        ("body_length", "upper", [0.05]),
        ("gravity_tilt", "upper", [0.1]),
        ("actuator_gain", "bend", [0.8]),
        ("actuator_dead_zone", "bend", [0.5]),
        ("actuator_delay", "bend", [0.013]),
        ("actuator_lag", "bend", [0.03]),
        ("actuator_rate_limit", "bend", [20.0]),
        ("actuator_saturation", "bend", [1.0]),
        ("backlash", "bend", [0.5]),
        ("sensor_offset", "elbow_position", [0.1]),
        ("sensor_scale", "elbow_velocity", [1.1]),
        ("sensor_delay", "elbow_position", [0.013]),
        ("sensor_lag", "elbow_velocity", [0.02]),
        ("eccentric_encoder", "elbow_position", [0.1, 0.05]),
    ],
)
def test_an_effect_is_that_of_the_equations(effect, target, values, tmp_path):
    """Up to the error of MuJoCo's integrator, which falls with its timestep."""
    (tmp_path / "arm.xml").write_text(ARM)
    chain = read_plant(tmp_path / "arm.xml", "equations")
    plant = read_plant(tmp_path / "arm.xml", "mujoco")
    active = EffectInstance(CATALOGUE[effect], target)
    start, u = np.array([[0.5, 0.3, -0.4, -0.5]]), commands(plant, 4)[None]
    bare, ours, theirs = (
        some.simulate(start, u, DT)
        for some in (chain, plant.having([(active, values)]), chain.having([(active, values)]))
    )
    moved = np.abs(theirs - bare).max()
    assert moved > 5e-3
    assert np.abs(ours - theirs).max() < 0.05 * moved + 0.02


@pytest.mark.parametrize("target", ["elbow_position", "elbow_velocity"])
def test_a_filter_of_a_sensor_begins_as_in_the_equations(target, tmp_path):
    """Where it is known how the motion came to its start."""
    (tmp_path / "arm.xml").write_text(ARM)
    active, lead = EffectInstance(CATALOGUE["sensor_lag"], target), 25
    start, x = np.array([[0.5, 0.3, -0.4, -0.5]]), 2 + target.endswith("velocity")
    path = start + np.linspace(-0.2, 0.1, lead + 1)[None, :, None] ** 2
    found = []
    for kind in ("equations", "mujoco"):
        plant = read_plant(tmp_path / "arm.xml", kind).having([(active, [0.03])])
        tables, each = plant.tables(plant.nominal[None]), np.zeros(1, dtype=int)
        given = tables, each, start, each, commands(plant)[None], lead, DT
        found += [plant.run(*given, path=known)[0, x] for known in (path, None)]
    np.testing.assert_allclose(found[0], found[2], rtol=0.02, atol=0.02)  # MuJoCo's steps
    assert found[0][0] == pytest.approx(found[2][0], abs=1e-6)
    assert abs(found[0][0] - found[1][0]) > 5e-3


def test_effects_of_contacts_are_what_they_say():
    """A block slides to rest in v^2 / (2 mu g); it stands where the ground is."""
    text = """
    <mujoco><option timestep="0.001" cone="elliptic" impratio="10"/><worldbody>
      <geom type="plane" size="5 5 1" friction="0.4"/>
      <body pos="0 0 0.05"><joint name="x" type="slide" axis="1 0 0"/>
        <joint name="z" type="slide" axis="0 0 1"/>
        <geom type="box" size="0.1 0.1 0.05" mass="1" friction="0.4"/></body>
    </worldbody></mujoco>"""
    plant = plant_of_text(text)
    start, u = np.array([[0.0, 2.0, 0.0, 0.0]]), np.zeros((1, 60, 0))

    def end(name: str, value: float) -> np.ndarray:
        active = EffectInstance(CATALOGUE[name], "ground")
        return plant.having([(active, [value])]).simulate(start, u, DT)[0, -1]

    for k in (1.0, 1.5):
        assert end("contact_friction", k)[0] == pytest.approx(4.0 / (2 * 0.4 * k * 9.81), rel=0.03)
    assert end("ground_height", 0.02)[2] - end("ground_height", 0.0)[2] == pytest.approx(
        0.02, abs=1e-3
    )
    soft, usual = (end("contact_stiffness", k)[2] for k in (0.1, 1.0))
    assert soft < usual - 1e-4


def test_a_servo_is_driven_by_its_target():
    plant = plant_of_text(MODELS["hopper"])
    assert plant.layout.servos == ("hip_servo",)
    assert plant.layout.unit_of("hip_servo") == ("rad", "rad")
    assert plant.layout.unit_of("knee_motor") == ("rad", "N m")
    stiff = plant.where(hip_servo_gain=300.0)
    u = np.tile([0.5, 0.0], (1, 50, 1))
    ends = [some.simulate(plant.rest[None], u, DT)[0, -1, 6] for some in (plant, stiff)]
    assert abs(ends[1] - 0.5) < abs(ends[0] - 0.5)


def test_what_it_cannot_have_is_refused_by_name():
    plant = plant_of_text(MODELS["hopper"])
    dead = EffectInstance(CATALOGUE["actuator_dead_zone"], "hip_servo")
    with pytest.raises(InputError, match=r"actuator_dead_zone \(hip_servo\) cannot be in robot"):
        plant.having([(dead, [0.1])])
    assert dead not in plant.candidates()
    with pytest.raises(InputError, match="spring cannot act at 'pitch'"):  # it has no bearing
        plant.having([(EffectInstance(CATALOGUE["spring"], "pitch"), [0.1])])
    ground = EffectInstance(CATALOGUE["contact_friction"], "ground")
    with pytest.raises(InputError, match="contact_friction cannot act at 'ground'"):
        plant_of_text(MODELS["loop"]).having([(ground, [0.5])])


def test_motions_of_a_batch_are_those_alone():
    plant = plant_of_text(MODELS["hopper"])
    u = np.stack([commands(plant, 4, seed) for seed in range(3)])
    start = np.tile(plant.rest, (3, 1))
    gains = {"knee_motor_gain": np.array([6.0, 8.0, 9.0])}
    together = plant.simulate(start, u, DT, gains)
    for n, gain in enumerate(gains["knee_motor_gain"]):
        alone = plant.where(knee_motor_gain=gain).simulate(start[:1], u[n : n + 1], DT)
        np.testing.assert_array_equal(together[n], alone[0])


def test_commands_keep_their_rate():
    """Those of 3 ms are held for a timestep of 3 ms where the model's own is 5 ms."""
    plant = plant_of_text(MODELS["hopper"])
    finer = replace(plant, model=mujoco.MjModel.from_xml_string(
        MODELS["hopper"].replace("0.005", "0.003")
    ))  # fmt: skip
    u = np.random.default_rng(0).uniform(-1, 1, (1, 40, 2))
    ours, theirs = (some.simulate(plant.rest[None], u, 0.003) for some in (plant, finer))
    np.testing.assert_array_equal(ours, theirs)


def test_a_contact_that_explodes_is_lost_and_others_are_not():
    plant = plant_of_text(MODELS["hopper"])
    deep = plant.rest.copy()
    deep[3] = -1e6
    y = plant.simulate(np.stack([plant.rest, deep]), np.zeros((2, 20, 2)), DT)
    assert np.isfinite(y[0]).all()
    assert np.isnan(y[1, 1:]).any(axis=1).all()
