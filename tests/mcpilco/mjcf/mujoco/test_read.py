"""Which kind of plant a file becomes, and what is said where it becomes none."""

from __future__ import annotations

import pytest

from mcpilco.mjcf import MujocoPlant, read_plant
from mcpilco.plant import ChainPlant
from mcpilco.typing import InputError
from tests.mcpilco.mjcf.mujoco.models import MODELS
from tests.mcpilco.mjcf.mujoco.test_plant import ARM

URDF = """
<robot name="arm">
  <link name="base"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.2"/><mass value="0.5"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="continuous"><parent link="base"/><child link="rod"/>
    <axis xyz="0 1 0"/><dynamics damping="0.1"/></joint>
</robot>
"""


@pytest.fixture
def file(tmp_path):
    def write(text: str, name: str = "robot.xml"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def test_equations_say_what_they_can_and_mujoco_the_rest(file):
    assert isinstance(read_plant(file(ARM)), ChainPlant)
    assert isinstance(read_plant(file(ARM), keyframe=""), ChainPlant)
    for text in MODELS.values():
        assert isinstance(read_plant(file(text)), MujocoPlant)
    with pytest.raises(InputError, match="free or ball"):
        read_plant(file(MODELS["box"]), "equations")


def test_an_arm_on_servos_in_free_air_becomes_equations(file):
    servo = '<position name="lift" joint="shoulder" kp="3"/><motor'
    plant = read_plant(
        file(ARM.replace('<motor name="lift" joint="shoulder" gear="3"/><motor', servo))
    )
    assert isinstance(plant, ChainPlant)
    assert plant.layout.servos == ("lift",)


def test_what_stands_on_the_ground_is_not_simulated_without_it(file):
    floor = '<worldbody><geom type="plane" size="1 1 1"/>'
    standing = ARM.replace("<worldbody>", floor).replace('contype="0"', "")
    assert isinstance(read_plant(file(standing)), MujocoPlant)
    above = standing.replace("<option", '<option><flag contact="disable"/></option><option')
    assert isinstance(read_plant(file(above)), ChainPlant)


def test_a_urdf_is_a_plant(file):
    plant = read_plant(file(URDF, "arm.urdf"))
    assert isinstance(plant, MujocoPlant)
    assert plant.layout.joints == ("hinge",)


@pytest.mark.parametrize(
    ("text", "keyframe", "says"),
    [
        (
            "<mujoco><worldbody><body><joint/></body></worldbody></mujoco>",
            "",
            "cannot? load|can load",
        ),
        ("<mujoco><worldbody/></mujoco>", "", "must have joints"),
        (MODELS["hopper"], "low", "no keyframe 'low'; it has high"),
        (MODELS["loop"], "low", "no keyframe 'low'; it has none"),
    ],
)
def test_a_model_that_is_no_plant_is_refused_in_one_sentence(file, text, keyframe, says):
    with pytest.raises(InputError, match=says) as caught:
        read_plant(file(text), keyframe=keyframe)
    assert str(caught.value).count("\n") == 0


def test_a_keyframe_is_the_pose_of_what_is_not_recorded(file):
    plant = read_plant(file(MODELS["hopper"]), keyframe="high")
    assert plant.rest.tolist() == [0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.2, 0.0, -0.4, 0.0]
