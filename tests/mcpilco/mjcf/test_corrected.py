"""A corrected MJCF file moves in plain MuJoCo as the corrected plant does."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mcpilco.mjcf.corrected import write_corrected_mjcf
from mcpilco.mjcf.models import plant_of
from mcpilco.plant.correction import Addition, Correction, corrected
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


def apart_at(tmp_path, fix, timestep, integrator="RK4"):
    """As `apart`, for a model whose own timestep this is, from a rest of the motors."""
    source, path = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    option = f'timestep="{timestep}" integrator="{integrator}"'
    source.write_text(ROBOT.replace('integrator="RK4"', option))
    assert write_corrected_mjcf(source, fix, path) == []
    inputs = pushes()
    inputs[:5] = 0.0
    return apart(source, fix, path, inputs, timestep)


def test_model_that_is_not_corrected_moves_as_its_plant(robot, tmp_path):
    fix = correction()
    assert write_corrected_mjcf(robot, fix, tmp_path / "corrected.xml") == []
    assert apart(robot, fix, tmp_path / "corrected.xml", pushes()) < 5e-5


@pytest.mark.parametrize("effect", SMOOTH, ids=lambda effect: f"{effect[0]}-{effect[1]}")
def test_both_forms_of_an_effect_move_alike(robot, tmp_path, effect):
    fix, path = correction(effect), tmp_path / "corrected.xml"
    assert write_corrected_mjcf(robot, fix, path) == []
    assert apart(robot, fix, path, pushes()) < 2e-4
    assert apart(robot, fix, robot, pushes()) > 2e-2  # the effect is felt


def test_all_smooth_effects_together_move_alike(robot, tmp_path):
    fix, path = correction(*SMOOTH), tmp_path / "corrected.xml"
    assert write_corrected_mjcf(robot, fix, path) == []
    assert apart(robot, fix, path, pushes()) < 2e-4


@pytest.mark.parametrize(
    "parameters",
    [
        {"gravity": 8.0},
        {"upper_mass": 0.6},
        {"lower_mass": 0.2},
        {"rail_damping": 0.8},
        {"push_gain": 7.0},
        {"bend_gain": 0.7},
    ],
    ids=lambda parameters: next(iter(parameters)),
)
def test_both_forms_of_a_parameter_move_alike(robot, tmp_path, parameters):
    fix, path = correction(**parameters), tmp_path / "corrected.xml"
    assert write_corrected_mjcf(robot, fix, path) == []
    assert apart(robot, fix, path, pushes()) < 2e-4
    assert apart(robot, fix, robot, pushes()) > 2e-2


def test_both_forms_of_a_servos_damping_move_alike(tmp_path):
    source, path = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    motor = '<motor name="bend" joint="elbow" gear="0.5"/>'
    servo = '<position name="bend" joint="elbow" gear="0.5" kp="4" kv="0.2"/>'
    source.write_text(ROBOT.replace(motor, servo))
    fix = correction(bend_damping_time=0.06, bend_gain=3.0)
    assert write_corrected_mjcf(source, fix, path) == []
    assert apart(source, fix, path, pushes()) < 2e-4
    assert apart(source, fix, source, pushes()) > 2e-2


def test_range_of_force_stays_when_the_gain_changes(tmp_path):
    source, path = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    source.write_text(ROBOT.replace('gear="0.5"', 'gear="0.5" forcerange="-0.4 0.4"'))
    fix = correction(("actuator_gain", "bend", {"k": 1.3}))
    assert write_corrected_mjcf(source, fix, path) == []
    assert apart(source, fix, path, pushes()) < 2e-4


TIMING = [
    ("actuator_delay", "push", {"d": 0.0234}),
    ("actuator_delay", "bend", {"d": 0.0467}),
    ("actuator_lag", "push", {"T": 0.03}),
    ("actuator_saturation", "push", {"u_m": 4.0}),
]
"""delays that end between two samples: at a jump itself the forms differ by a part of a step"""


@pytest.mark.parametrize("effects", [TIMING[:1], TIMING[1:2], TIMING[2:3], TIMING[:3]])
def test_timing_is_met_to_second_order_by_runge_kutta(tmp_path, effects):
    coarse, fine = (apart_at(tmp_path, correction(*effects), h) for h in (2e-3, 1e-3))
    assert coarse < 2e-3
    assert fine < 0.35 * coarse or fine < 2e-5


def test_delay_of_a_limited_command_is_met_to_first_order(tmp_path):
    """MuJoCo interpolates between commands before it limits them."""
    coarse, fine = (apart_at(tmp_path, correction(*TIMING), h) for h in (2e-3, 5e-4))
    assert fine < 0.35 * coarse
    assert fine < 0.02


@pytest.mark.parametrize("effects", [[], TIMING[:1], TIMING[2:3], TIMING])
def test_timing_is_met_to_the_order_of_the_other_integrators(tmp_path, effects):
    coarse, fine = (
        apart_at(tmp_path, correction(*effects), h, "implicitfast") for h in (5e-4, 2.5e-4)
    )
    assert 0.4 * coarse < fine < 0.6 * coarse


DRY = [
    ("coulomb_friction", "elbow", {"f_c": 0.05, "v_r": 5e-4}),
    ("coulomb_friction", "rail", {"f_c": 1.0, "v_r": 5e-4}),
    ("asymmetric_friction", "rail", {"f_p": 1.0, "f_n": 0.5, "v_r": 5e-4}),
]


@pytest.mark.parametrize("effect", DRY, ids=lambda effect: f"{effect[0]}-{effect[1]}")
def test_dry_friction_of_mujoco_nears_that_of_the_plant_as_the_timestep_shrinks(tmp_path, effect):
    coarse, fine = (apart_at(tmp_path, correction(effect), h) for h in (1e-3, 2.5e-4))
    assert fine < 0.4 * coarse
    assert fine < 1e-2


def test_dry_friction_holds_a_joint_with_little_creep(robot, tmp_path):
    fix = correction(("coulomb_friction", "rail", {"f_c": 4.0}), rail_damping=0.0)
    write_corrected_mjcf(robot, fix, tmp_path / "corrected.xml")
    pull = np.tile([0.2, 0.0], (100, 1))  # 2 N, of the 4 N that it holds
    motion = mujoco_motion(tmp_path / "corrected.xml", pull, 2e-3, np.zeros(6))
    assert np.abs(motion[:, 0]).max() < 2e-4


def test_asymmetric_friction_holds_more_in_one_direction(robot, tmp_path):
    fix = correction(("asymmetric_friction", "rail", {"f_p": 2.0, "f_n": 0.5}))
    write_corrected_mjcf(robot, fix, tmp_path / "corrected.xml")
    pull = np.tile([0.12, 0.0], (50, 1))
    right = mujoco_motion(tmp_path / "corrected.xml", pull, 2e-3, np.zeros(6))[-1, 0]
    left = mujoco_motion(tmp_path / "corrected.xml", -pull, 2e-3, np.zeros(6))[-1, 0]
    assert abs(right) < 0.01
    assert left < -0.1


@pytest.mark.parametrize("effect", SAID_OUTSIDE, ids=lambda effect: effect[0])
def test_what_mjcf_cannot_say_is_told_and_left_out(robot, tmp_path, effect):
    name, target, values, remedy = effect
    sentences = write_corrected_mjcf(
        robot, correction((name, target, values)), tmp_path / "corrected.xml"
    )
    assert len(sentences) == 1
    assert f"MJCF cannot say {name} ({target}; " in sentences[0]
    assert remedy in sentences[0]
    write_corrected_mjcf(robot, correction(), tmp_path / "plain.xml")
    assert (tmp_path / "plain.xml").read_text() == (tmp_path / "corrected.xml").read_text()


def test_delay_below_the_timestep_is_told(robot, tmp_path):
    fix = correction(("actuator_delay", "push", {"d": 0.001}))
    (sentence,) = write_corrected_mjcf(robot, fix, tmp_path / "corrected.xml")
    assert "a timestep of 0.002 s at least" in sentence


GEOM = 'inertiafromgeom="true"'
OTHER_FILES = {
    "inertias always from geoms": ('angle="degree"', f'angle="degree" {GEOM}'),
    "a given total mass": ('angle="degree"', 'angle="degree" settotalmass="2"'),
    "angles in radians": (
        'angle="degree"',
        'angle="radian"',
    ),
    "an inertia that is given in full": (
        '<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.3"/>',
        '<inertial pos="0.01 0 -0.1" mass="0.3" fullinertia="0.003 0.003 0.001 0 0.0002 0"/>',
    ),
    "a frame that is turned": (
        '<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.3"/>',
        '<inertial pos="0.01 0 -0.1" euler="0 30 0" mass="0.3" diaginertia="0.003 0.003 0.001"/>',
    ),
    "joints that are not parallel": (
        '<joint name="elbow" axis="0 -1 0"',
        '<joint name="elbow" axis="0.6 -0.8 0"',
    ),
}


@pytest.mark.parametrize("change", OTHER_FILES.values(), ids=list(OTHER_FILES))
def test_both_forms_move_alike_however_the_file_says_its_bodies(tmp_path, change):
    before, after = change
    assert before in ROBOT
    source, path = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    source.write_text(ROBOT.replace(before, after))
    effects = [
        ("body_mass", "lower", {"m_d": 0.1}),
        ("center_of_mass", "lower", {"c_d": 0.03}),
        ("body_inertia", "lower", {"I_d": 0.0005}),
        ("constant_force", "elbow", {"f_0": 0.1}),
    ]
    if "0.6" in after:  # no capsule has more inertia about one axis only
        del effects[2]
    fix = correction(*effects)
    untouched = np.abs(
        mujoco_motion(source, pushes(), 5e-4)
        - plant_of(source).simulate(START[None], pushes()[None], DT)[0]
    ).max()
    assert write_corrected_mjcf(source, fix, path) == []
    assert apart(source, fix, path, pushes()) < 2e-4 + untouched


def test_impossible_inertia_is_told(tmp_path):
    source = tmp_path / "robot.xml"
    source.write_text(ROBOT.replace('"elbow" axis="0 -1 0"', '"elbow" axis="0.6 -0.8 0"'))
    fix = correction(("body_inertia", "lower", {"I_d": 0.01}))
    (sentence,) = write_corrected_mjcf(source, fix, tmp_path / "corrected.xml")
    assert "no mass distribution has such an inertia" in sentence
    mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))


def test_meshes_are_found_from_another_folder(tmp_path):
    (tmp_path / "model" / "meshes").mkdir(parents=True)
    corners = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
    (tmp_path / "model" / "meshes" / "corner.obj").write_text("\n".join(lines))
    text = ROBOT.replace('angle="degree"', 'angle="degree" meshdir="meshes"')
    text = text.replace(
        "<worldbody>", '<asset><mesh name="m" file="corner.obj"/></asset><worldbody>'
    )
    text = text.replace("</worldbody>", '<geom type="mesh" mesh="m"/></worldbody>')
    source = tmp_path / "model" / "robot.xml"
    source.write_text(text)
    (tmp_path / "gap").mkdir()
    fix = correction(("spring", "rail", {"k": 5.0}))
    write_corrected_mjcf(source, fix, tmp_path / "gap" / "corrected.xml")
    assert apart(source, fix, tmp_path / "gap" / "corrected.xml", pushes()) < 2e-4


def test_nominal_file_is_left_alone_and_equal_corrections_give_equal_files(robot, tmp_path):
    paths = [tmp_path / "one.xml", tmp_path / "two.xml"]
    for path in paths:
        write_corrected_mjcf(robot, correction(*SMOOTH), path)
    assert robot.read_text() == ROBOT
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.parametrize(
    ("fix", "sentence"),
    [
        (Correction("other", {}, ()), "is for the plant 'other', got 'robot'"),
        (correction(("spring", "wheel", {"k": 1.0})), "cannot act at 'wheel' of robot"),
        (correction(rail_friction=1.0), "has no parameter 'rail_friction'"),
    ],
)
def test_correction_that_does_not_fit_gets_a_sentence_and_no_file(robot, tmp_path, fix, sentence):
    with pytest.raises(InputError, match=sentence):
        write_corrected_mjcf(robot, fix, tmp_path / "corrected.xml")
    assert not (tmp_path / "corrected.xml").exists()
