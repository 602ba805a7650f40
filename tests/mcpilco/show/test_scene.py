from __future__ import annotations

import mujoco
import numpy as np
import pytest

import envs
from mcpilco.bodies import HINGE, SLIDE, Body, Chain
from mcpilco.show.scene import chain_scene
from tests.reference.cartpole import CartPoleDynamics
from tests.reference.pendulum import PendulumDynamics

TILTED = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
ARM = """
<mujoco><worldbody>
  <body name="a" pos="0.1 0.2 0.3" xyaxes="0 1 0 0 0 1">
    <joint name="a" axis="0 0.6 0.8"/>
    <geom type="sphere" size="0.1" pos="0.2 0 0"/>
    <body name="b" pos="0.4 0 -0.1">
      <joint name="b" type="slide" axis="1 0 0"/>
      <geom type="sphere" size="0.1" pos="0 0.3 0"/>
      <site name="tip" pos="0 0.3 0"/>
    </body>
  </body>
</worldbody></mujoco>
"""


def chain(plant: str) -> Chain:
    nominal = envs.PLANTS[plant]()
    return nominal.chain


@pytest.mark.parametrize(
    ("plant", "dynamics"),
    [
        ("mcpilco/CartPoleSwingUp-v0", CartPoleDynamics.nominal()),
        ("mcpilco/Pendulum-v0", PendulumDynamics.nominal()),
    ],
)
def test_the_marker_of_a_plant_is_the_tip_that_its_env_draws(plant: str, dynamics) -> None:
    rng = np.random.default_rng(0)
    width = 2 * len(chain(plant).bodies)
    states = rng.normal(size=(20, width))
    np.testing.assert_allclose(
        chain_scene(chain(plant)).marker(states), dynamics.tip(states), atol=1e-12
    )


def test_bodies_are_where_mujoco_has_them() -> None:
    model = mujoco.MjModel.from_xml_string(ARM)
    data = mujoco.MjData(model)
    arm = Chain(
        (
            Body(name="a", joint="a", kind=HINGE, axis=(0.0, 0.6, 0.8), mass=1.0,
                 origin=(0.1, 0.2, 0.3), rotation=TILTED, center=(0.2, 0.0, 0.0)),
            Body(name="b", joint="b", kind=SLIDE, axis=(1.0, 0.0, 0.0), mass=1.0, parent=0,
                 origin=(0.4, 0.0, -0.1), center=(0.0, 0.3, 0.0)),
        )
    )  # fmt: skip
    states = np.random.default_rng(1).normal(size=(5, 4))
    scene = chain_scene(arm)
    poses = scene.poses(states)
    for row, state in enumerate(states):
        data.qpos[:] = state[0::2]
        mujoco.mj_kinematics(model, data)
        tip = data.site("tip").xpos
        np.testing.assert_allclose(scene.marker(states)[row], tip, atol=1e-12)
        middle = 0.5 * (data.body("b").xpos + tip)
        np.testing.assert_allclose(poses["b"].translation[row], middle, atol=1e-12)


def test_a_capsule_lies_along_its_link() -> None:
    states = np.random.default_rng(2).normal(size=(8, 4))
    scene = chain_scene(chain("mcpilco/DoublePendulum-v0"))
    pose, shape = scene.poses(states)["lower"], scene.shapes["lower"]
    x, y, z, w = pose.quaternion.T  # the body's z axis in the world
    along = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x**2 + y**2)], axis=1)
    ends = pose.translation + along * shape.size[1]
    np.testing.assert_allclose(ends, scene.marker(states), atol=1e-12)


def test_a_body_without_length_is_a_box() -> None:
    assert chain_scene(chain("mcpilco/CartPoleSwingUp-v0")).shapes["cart"].kind == "box"
