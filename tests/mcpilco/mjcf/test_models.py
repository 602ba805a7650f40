"""An MJCF file as a plant: its motions are MuJoCo's, and what it cannot be is named."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from mcpilco.config import TURN_OVER
from mcpilco.mjcf.models import creep, load_mjcf, plant_of
from mcpilco.mjcf.mujoco.read import mujoco_plant
from mcpilco.plant.effects import CATALOGUE
from mcpilco.plant.plant import EffectInstance
from mcpilco.typing import InputError

ARM = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0.3 0.5 -9.7"/>
  <worldbody>
    <body name="base" pos="0 0 0.4" euler="0.2 0.3 0">
      <geom type="box" size="0.1 0.1 0.02" mass="5" contype="0" conaffinity="0"/>
      <body name="upper" pos="0.1 0 0">
        <joint name="yaw" axis="0 0 1" damping="0.4" armature="0.02"/>
        <joint name="pitch" axis="0 1 0" pos="0.02 0.01 0.05" damping="0.2" stiffness="3"
               springref="0.4"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0.3" size="0.03" mass="1.2" contype="0"
              conaffinity="0"/>
        <body name="flange" pos="0.2 0 0.3" quat="0.8 0.1 0.5 0.2">
          <geom type="box" pos="0.03 0 0" size="0.05 0.03 0.02" mass="0.4" contype="0"
                conaffinity="0"/>
          <body name="slider" pos="0 0 0.1">
            <joint name="reach" type="slide" axis="0 0.6 0.8" pos="0.1 0 0" damping="2"
                   stiffness="20"/>
            <geom type="sphere" size="0.05" mass="0.3" contype="0" conaffinity="0"/>
            <body name="tool" pos="0.05 0 0.1"><geom type="box" size="0.02 0.05 0.01" mass="0.1"
                  contype="0" conaffinity="0"/></body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="yaw_motor" joint="yaw" gear="3"/>
    <motor name="pitch_motor" joint="pitch" gear="-5" ctrlrange="-0.8 0.8" ctrllimited="true"/>
    <general name="reach_motor" joint="reach" gainprm="2" gear="1.5" forcerange="-1.2 1.2"
             forcelimited="true"/>
  </actuator>
</mujoco>
"""
SERVOS = """<actuator>
    <position name="yaw_servo" joint="yaw" kp="2" kv="0.3" gear="2" ctrlrange="-0.2 1.4"
              forcerange="-1.2 1.2" forcelimited="true"/>
    <velocity name="pitch_servo" joint="pitch" kv="2"/>
    <general name="reach_servo" joint="reach" gainprm="30" biastype="affine"
             biasprm="0.5 -25 -3"/>
  </actuator>
</mujoco>
"""
SIMPLE = """<mujoco>{option}<worldbody><body name="b">{joint}<geom name="g" size=".1"/>
  <body name="c" pos="0 0 1"><joint name="k"/><geom size=".1"/></body></body></worldbody>
  {more}<actuator>{actuator}</actuator></mujoco>"""
TWICE = '<motor name="m" joint="j"/><motor name="n" joint="j"/>'
MOTOR, HINGE = '<motor name="m" joint="j"/>', '<joint name="j"/>'


@pytest.fixture
def plant_from(tmp_path):
    """Of the text of an MJCF."""

    def make(text: str):
        path = tmp_path / "robot.xml"
        path.write_text(text)
        return plant_of(path)

    return make


def commands(steps: int) -> np.ndarray:
    """(steps, 3) for `ARM`, beyond the limits now and then."""
    return np.repeat(np.random.default_rng(0).uniform(-1.5, 1.5, (steps // 5, 3)), 5, axis=0)


def stepped(text: str, start: np.ndarray, inputs: np.ndarray, dt: float, step: float, how: str):
    """States (T + 1, X) as MuJoCo itself finds them."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = step
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{how}")
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start[0::2], start[1::2]
    states = [start]
    for row in inputs:
        data.ctrl[:] = row
        for _ in range(round(dt / step)):
            mujoco.mj_step(model, data)
        states.append(np.column_stack([data.qpos, data.qvel]).ravel())
    return np.array(states)


START = np.array([0.3, 1.0, -0.4, 0.5, 0.02, -0.3])


def test_an_arm_is_named_as_in_its_file(plant_from):
    plant = plant_from(ARM)
    assert plant.name == "robot"
    assert plant.layout.joints == ("yaw", "pitch", "reach")
    assert plant.layout.bodies == ("upper_yaw", "upper", "slider")
    assert plant.layout.states[:2] == ("yaw_position", "yaw_velocity")
    assert plant.layout.inputs == ("yaw_motor", "pitch_motor", "reach_motor")
    assert plant.angles == (0, 2)
    values = {parameter.name: parameter.value for parameter in plant.parameters}
    assert values == pytest.approx(
        {
            "upper_mass": 1.6,  # with the flange, that is welded to it
            "slider_mass": 0.4,
            "yaw_damping": 0.4,
            "pitch_damping": 0.2,
            "reach_damping": 2.0,
            "yaw_motor_gain": 3.0,
            "pitch_motor_gain": -5.0,
            "reach_motor_gain": 3.0,
            "gravity": np.sqrt(0.3**2 + 0.5**2 + 9.7**2),
        }
    )


def test_an_arm_moves_as_mujoco_steps_it_with_high_order(plant_from):
    inputs = commands(50)
    found = plant_from(ARM).simulate(START[None], inputs[None], 0.02)[0]
    expected = stepped(ARM, START, inputs, 0.02, 1e-3, "RK4")
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=3e-5)
    assert np.abs(expected - START).max() > 0.5


def test_an_arm_on_servos_moves_as_mujoco_steps_it(plant_from):
    """On a position servo that its force limits, a velocity servo, and an affine actuator."""
    inputs, text = commands(50), ARM[: ARM.index("<actuator>")] + SERVOS
    plant = plant_from(text)
    assert plant.layout.targets == ("rad", "rad/s", "m")
    found = plant.simulate(START[None], inputs[None], 0.02)[0]
    expected = stepped(text, START, inputs, 0.02, 1e-4, "RK4")
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=5e-4)  # the limit is a kink
    free = text.replace('forcerange="-1.2 1.2" forcelimited="true"', "")
    assert np.abs(stepped(free, START, inputs, 0.02, 1e-3, "RK4") - expected).max() > 0.1
    q, v = found[:, 0::2], found[:, 1::2]
    forces = plant.actuation(q[:50], v[:50], inputs)
    assert np.abs(forces[:, 0]).max() == pytest.approx(1.2 * 2.0)  # its gear times the limit


def test_the_damping_of_a_position_servo_is_a_parameter(plant_from):
    """That of a velocity servo is its gain."""
    text = ARM[: ARM.index("<actuator>")] + SERVOS
    plant, inputs = plant_from(text), commands(50)[None]
    times = {name: p for name, p in plant.values.items() if name.endswith("damping_time")}
    assert times == pytest.approx({"yaw_servo_damping_time": 0.3, "reach_servo_damping_time": 0.1})
    found = plant.where(yaw_servo_damping_time=0.45).simulate(START[None], inputs, 0.02)
    expected = plant_from(text.replace('kv="0.3"', 'kv="0.45"')).simulate(START[None], inputs, 0.02)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9)
    assert np.abs(found - plant.simulate(START[None], inputs, 0.02)).max() > 1e-2


@pytest.mark.parametrize("effect", [("actuator_gain", [0.7]), ("actuator_saturation", [1.0])])
def test_both_kinds_of_plant_have_the_same_effects_of_servos(plant_from, effect):
    text = ARM[: ARM.index("<actuator>")] + SERVOS
    inputs, model = commands(25)[None], mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
    hidden = (EffectInstance(CATALOGUE[effect[0]], "yaw_servo"), effect[1])
    plants = plant_from(text), mujoco_plant(model, "robot")
    without, by_mujoco = (plant.simulate(START[None], inputs, 0.02) for plant in plants)
    np.testing.assert_allclose(by_mujoco, without, atol=5e-4)
    by_equations, by_mujoco = (
        plant.having([hidden]).simulate(START[None], inputs, 0.02) for plant in plants
    )
    np.testing.assert_allclose(by_mujoco, by_equations, atol=5e-4)
    assert np.abs(by_equations - without).max() > 0.02


def test_a_servo_has_no_dead_zone(plant_from):
    plant = plant_from(ARM[: ARM.index("<actuator>")] + SERVOS)
    with pytest.raises(InputError, match="the command of a servo is a target, and no force"):
        plant.having([(EffectInstance(CATALOGUE["actuator_dead_zone"], "yaw_servo"), [0.1])])


def test_mujocos_own_steps_come_closer_in_proportion_to_their_length(plant_from):
    inputs = commands(25)
    found = plant_from(ARM).simulate(START[None], inputs[None], 0.02)[0]
    errors = [
        np.abs(stepped(ARM, START, inputs, 0.02, step, "EULER") - found).max()
        for step in (2e-3, 1e-3, 5e-4)
    ]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.1)


PENDULUM = """<mujoco><compiler angle="radian"/>
  <option integrator="{how}" timestep="{step}">{flags}</option><worldbody><body>
  <joint name="j" axis="0 1 0" damping="0.2"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1" contype="0" conaffinity="0"/>
  </body></worldbody><actuator>
  <position name="p" joint="j" kp="3" kv="0.15" gear="2"/></actuator></mujoco>"""
EXPLICIT = '<flag eulerdamp="disable"/>'


@pytest.mark.parametrize(
    ("how", "flags", "damping"),
    [
        ("implicitfast", "", 0.2 + 0.6),
        ("implicit", "", 0.2 + 0.6),
        ("Euler", "", 0.2 - 0.6),
        ("Euler", EXPLICIT, -0.2 - 0.6),
    ],
)
def test_a_pendulum_in_steps_is_mujocos_to_second_order(plant_from, how, flags, damping):
    """Positions are those of half a step later, and the damping of joint and servo is inertia."""
    inputs, errors = commands(25)[:, :1], []
    for h in (4e-3, 2e-3):
        text = PENDULUM.format(how=how, step=h, flags=flags)
        plant = plant_from(text)
        assert plant.in_steps().integrator.inertia == pytest.approx((0.5 * h * damping,))
        expected = stepped(text, START[:2], inputs, 0.02, h, how.upper())
        plain = plant.simulate(START[None, :2], inputs[None], 0.02)[0] - expected
        expected[:, 0] -= 0.5 * h * expected[:, 1]
        left = plant.in_steps().simulate(expected[None, 0], inputs[None], 0.02)[0] - expected
        errors.append(np.abs([plain, left]).max(axis=1))
    np.testing.assert_allclose(errors[0][0] / errors[1][0], 2.0, rtol=0.1)
    np.testing.assert_allclose(errors[0][1] / errors[1][1], 4.0, rtol=0.1)
    assert (errors[1][1] < 0.05 * errors[1][0]).all()
    assert plant.in_steps().in_steps(0.0).chain == plant.chain != plant.in_steps().chain


def test_runge_and_kuttas_steps_make_no_difference(plant_from):
    plant = plant_from(PENDULUM.format(how="RK4", step=4e-3, flags=""))
    assert plant.in_steps() is plant


def test_parameters_are_those_of_the_model(plant_from):
    """Each of them changed in the plant, and in the file."""
    changed = (
        ARM.replace('damping="0.4"', 'damping="0.7"')
        .replace('gear="3"', 'gear="2.5"')
        .replace('gear="-5"', 'gear="-5.5"')
        .replace('gravity="0.3 0.5 -9.7"', 'gravity="0.15 0.25 -4.85"')
        .replace('mass="0.3"', 'mass="0.45"')
        .replace('mass="0.1"', 'mass="0.15"')
    )
    plant = plant_from(ARM)
    values = {parameter.name: parameter.value for parameter in plant.parameters}
    other = plant.where(
        yaw_damping=0.7,
        yaw_motor_gain=2.5,
        pitch_motor_gain=-5.5,
        gravity=0.5 * values["gravity"],
        slider_mass=0.6,
    )
    inputs = commands(20)
    expected = plant_from(changed).simulate(START[None], inputs[None], 0.02)
    found = other.simulate(START[None], inputs[None], 0.02)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-5)


def test_dry_friction_slows_down_as_in_mujoco(plant_from):
    text = SIMPLE.format(
        option='<option gravity="0 0 0"/>',
        joint='<joint name="j" type="slide" axis="1 0 0" frictionloss="0.5"/>',
        more="",
        actuator=MOTOR,
    )
    plant = plant_from(text)
    values = {parameter.name: parameter.value for parameter in plant.parameters}
    assert values["j_friction"] == 0.5
    start, inputs = np.array([0.0, 1.0, 0.0, 0.0]), np.zeros((25, 1))
    found = plant.simulate(start[None], inputs[None], 0.02)[0]
    expected = stepped(text, start, inputs, 0.02, 1e-3, "EULER")
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-4)
    assert found[-1, 1] < 0.98


@pytest.mark.parametrize("solver", ["", 'solreffriction="0.05 1"', 'solreffriction="-900 -60"'])
def test_a_joint_creeps_under_half_of_its_dry_friction_as_in_mujoco(plant_from, solver):
    """It moves little, so that its friction is soft."""
    text = SIMPLE.format(
        option='<option gravity="0 0 0"/>',
        joint=f'<joint name="j" type="slide" axis="1 0 0" frictionloss="0.5" {solver}/>',
        more="",
        actuator=MOTOR,
    ).replace('size=".1"', 'size=".1" mass="0.005"')
    model = mujoco.MjModel.from_xml_string(text)
    assert creep(model, 0) > 10.0 * TURN_OVER
    inputs = np.full((50, 1), 0.25)
    found = plant_from(text).simulate(np.zeros((1, 4)), inputs[None], 0.02)[0]
    expected = stepped(text, np.zeros(4), inputs, 0.02, 1e-4, "EULER")
    assert expected[-1, 1] == pytest.approx(0.5 * creep(model, 0), rel=1e-3)
    assert found[-1, 1] == pytest.approx(expected[-1, 1], rel=1e-3)


@pytest.mark.parametrize("solver", ["", 'solreffriction="0.06 1" solimpfriction="0.7 0.9"'])
def test_joints_stick_and_slip_together_as_in_mujoco(plant_from, solver):
    """Friction lets go before a joint turns, and what sticks moves with what pushes it."""
    rubbed = ARM
    for joint, most in (("yaw", 1.5), ("pitch", 1.0), ("reach", 0.6)):
        rubbed = rubbed.replace(f'name="{joint}"', f'name="{joint}" frictionloss="{most}" {solver}')
    inputs = commands(50)
    found = plant_from(rubbed).simulate(START[None], inputs[None], 0.02)[0]
    expected = stepped(rubbed, START, inputs, 0.02, 2e-5, "EULER")
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=2e-4)
    turns = np.diff(np.sign(expected[:, 1::2]), axis=0) != 0
    assert turns.any(axis=0).all(), "friction turns over in each"


@pytest.mark.parametrize("effect", ["body_mass", "center_of_mass"])
def test_effects_at_a_body_without_mass_are_finite(plant_from, effect):
    """Between two joints of one body there is nothing; a point mass may be there."""
    plant = plant_from(ARM).having([(EffectInstance(CATALOGUE[effect], "upper_yaw"), [0.1])])
    assert np.isfinite(plant.simulate(START[None], commands(5)[None], 0.02)).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"joint": "<freejoint/>", "actuator": '<motor joint="k"/>'}, "1 free or ball joints"),
        ({"joint": '<joint name="j" type="ball"/>'}, "1 free or ball joints"),
        ({"joint": '<joint name="j" damping="1 2"/>'}, "1 joints with polynomial damping"),
        ({"joint": '<joint name="j" stiffness="1 2"/>'}, "1 joints with polynomial stiffness"),
        ({"actuator": '<position joint="j" kp="0" kv="1"/>'}, "1 muscles and other actuators"),
        (
            {"actuator": '<general joint="j" dyntype="filter" dynprm=".1"/>'},
            "actuators with states",
        ),
        ({"actuator": '<motor joint="j" delay="0.01" nsample="5"/>'}, "1 actuators with a delay"),
        ({"actuator": '<damper joint="j" kv="1" ctrlrange="0 1"/>'}, "no affine function"),
        ({"actuator": '<motor joint="j" forcerange="-1 2"/>'}, "not symmetric about 0"),
        ({"joint": HINGE + '<site name="s"/>', "actuator": '<motor site="s"/>'}, "without a joint"),
        (
            {"joint": '<joint name="j" actuatorfrcrange="-1 1"/>', "actuator": TWICE},
            "several motors",
        ),
        (
            {"more": '<equality><joint joint1="j" joint2="k"/></equality>'},
            "1 equality constraints",
        ),
        (
            {"more": '<tendon><fixed><joint joint="j" coef="1"/></fixed></tendon>'},
            "1 tendons",
        ),
        ({"option": '<option density="1.2"/>'}, "1 fluids"),
        ({"option": '<option><flag gravity="disable"/></option>'}, "1 options that switch"),
        ({"option": '<option><flag damper="disable"/></option>'}, "options that switch"),
        ({"actuator": ""}, "must have joints and motors, got 2 and 0"),
    ],
)
def test_what_a_plant_cannot_be_is_named(plant_from, change, said):
    parts = {"option": "", "joint": HINGE, "more": "", "actuator": MOTOR}
    with pytest.raises(InputError, match=said):
        plant_from(SIMPLE.format(**parts | change))


@pytest.mark.parametrize(
    ("body", "joint", "motor", "said"),
    [
        ("a", "b", "b", None),
        ("a", "a", "a", None),
        ("k", "j", "m", "got k at several"),
        ("b", "c", "m", "got c at several"),
        ("b", "j", "k_position", "got k_position at several"),
    ],
)
def test_a_name_stands_for_one_joint(plant_from, body, joint, motor, said):
    text = SIMPLE.format(
        option="",
        joint=f'<joint name="{joint}"/>',
        more="",
        actuator=f'<motor name="{motor}" joint="{joint}"/>',
    ).replace('<body name="b">', f'<body name="{body}">')
    text = text.replace('name="c"', 'name="d"') if body == "k" else text
    if said is None:
        assert plant_from(text).layout.joint_of(joint) == 0
    else:
        with pytest.raises(InputError, match=said):
            plant_from(text)


def test_contacts_and_limits_of_joints_are_passed_over(plant_from):
    """As the documentation says: the motion goes on as if nothing were in its way."""
    slide = '<joint name="j" type="slide" axis="0 0 1" {}/>'
    free = {"option": "", "joint": slide.format(""), "more": "", "actuator": MOTOR}
    limited = free | {"joint": slide.format('range="-0.01 1"')}
    floor = '<worldbody><geom type="plane" size="1 1 1" pos="0 0 -0.1"/>'
    start, inputs = np.zeros((1, 4)), np.zeros((1, 20, 1))
    expected = plant_from(SIMPLE.format(**free)).simulate(start, inputs, 0.02)
    text = SIMPLE.format(**limited).replace("<worldbody>", floor)
    np.testing.assert_array_equal(plant_from(text).simulate(start, inputs, 0.02), expected)
    assert expected[0, -1, 0] < -0.5


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(
        InputError, match="must be the id of an env or an MJCF file, got .*none.xml"
    ):
        plant_of(tmp_path / "none.xml")


@pytest.mark.parametrize("text", ["", "time,angle\n0,1\n", "<mujoco><worldbody>"])
def test_a_broken_file_is_named(plant_from, text):
    with pytest.raises(InputError, match="robot.xml is no model that MuJoCo can load: "):
        plant_from(text)


def written(path: Path, world: str, option: str = "") -> Path:
    path.write_text(f"<mujoco>{option}<worldbody>{world}</worldbody></mujoco>")
    return path


@pytest.mark.parametrize(
    "world",
    [
        "<replicate count='100000000'><geom size='1'/></replicate>",
        "<replicate count='1e8'><geom size='1'/></replicate>",
        "<replicate count='1000'><replicate count='1000'><geom size='1'/></replicate></replicate>",
        "<body><composite type='cable' count='1000000 1 1'/></body>",
        "<replicate count='1000'><include file='many.xml'/></replicate>",
    ],
)
def test_a_model_of_more_than_a_machine_can_hold_is_refused_unread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, world: str
) -> None:
    """MuJoCo, which writes out all copies, never sees it."""
    many = "<mujocoinclude><replicate count='1000'><geom size='1'/></replicate></mujocoinclude>"
    (tmp_path / "many.xml").write_text(many)
    monkeypatch.setattr(mujoco.MjModel, "from_xml_path", None)
    with pytest.raises(InputError, match="at most 100000 elements.*lower their count"):
        load_mjcf(written(tmp_path / "robot.xml", world))


def test_copies_that_a_machine_can_hold_are_loaded(tmp_path: Path) -> None:
    """Also where files include one another in a circle, which MuJoCo answers itself."""
    world = "<replicate count='10' offset='1 0 0'><geom size='1'/></replicate>"
    assert load_mjcf(written(tmp_path / "robot.xml", world)).ngeom == 10
    with pytest.raises(InputError, match="is no model that MuJoCo can load"):
        load_mjcf(written(tmp_path / "circle.xml", "<include file='circle.xml'/>"))


@pytest.mark.parametrize("number", ["mass='nan'", "mass='inf'", "mass='1'/><joint damping='nan'"])
def test_numbers_that_are_not_finite_are_refused(tmp_path: Path, number: str) -> None:
    world = f"<body><joint axis='1 0 0'/><geom size='1' {number}/></body>"
    with pytest.raises(InputError, match="cannot be simulated"):
        load_mjcf(written(tmp_path / "robot.xml", world))


@pytest.mark.parametrize("step", ["0", "-0.01", "inf", "nan"])
def test_a_time_step_must_be_positive(tmp_path: Path, step: str) -> None:
    path = written(tmp_path / "robot.xml", "", f"<option timestep='{step}'/>")
    with pytest.raises(InputError, match=r"timestep must be positive \[s\], got"):
        load_mjcf(path)


def test_mujoco_writes_no_log_where_the_user_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Its warnings go where all others go."""
    monkeypatch.chdir(tmp_path)
    model = load_mjcf(written(tmp_path / "robot.xml", "<body><joint/><geom size='1'/></body>"))
    data = mujoco.MjData(model)
    data.qvel[:] = np.nan
    mujoco.mj_step(model, data)
    assert [path.name for path in tmp_path.iterdir()] == ["robot.xml"]
    assert "simulation is unstable" in caplog.text
