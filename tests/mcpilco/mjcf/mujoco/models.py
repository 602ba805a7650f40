"""Models of these tests: a hopper on servos, a free box, an arm with a tendon and a loop."""

from __future__ import annotations

import mujoco

from mcpilco.mjcf import MujocoPlant, mujoco_plant

HOPPER = """
<mujoco model="hopper">
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 0.1"/>
    <body name="trunk" pos="0 0 0.5">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="pitch" axis="0 1 0"/>
      <geom type="box" size="0.1 0.05 0.04" mass="1.5"/>
      <body name="thigh">
        <joint name="hip" axis="0 1 0" damping="0.2" armature="0.01"/>
        <geom type="box" pos="0.02 0 -0.1" size="0.02 0.02 0.1" mass="0.4"/>
        <body name="shank" pos="0.05 0 -0.2">
          <joint name="knee" axis="0 1 0" damping="0.1" armature="0.01"/>
          <geom name="foot" type="box" pos="-0.02 0 -0.11" size="0.02 0.02 0.12" mass="0.2"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hip_servo" joint="hip" kp="30" kv="1" ctrlrange="-1 1"/>
    <motor name="knee_motor" joint="knee" gear="8" ctrlrange="-1 1"/>
  </actuator>
  <keyframe><key name="high" qpos="0 0.3 0 0.2 -0.4"/></keyframe>
</mujoco>
"""
BOX = """
<mujoco model="box">
  <option timestep="0.004"/>
  <worldbody>
    <geom type="plane" size="2 2 0.1"/>
    <body name="crate" pos="0 0 0.4" euler="20 10 0">
      <freejoint name="base"/>
      <geom type="box" size="0.1 0.08 0.05" mass="1"/>
      <body name="arm" pos="0.1 0 0">
        <joint name="swing" type="ball" damping="0.01"/>
        <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.2"/>
        <site name="tip" pos="0.2 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="twist" joint="swing" gear="0 0.2 0.1"/></actuator>
</mujoco>
"""
LOOP = """
<mujoco model="loop">
  <option timestep="0.002" density="1000" viscosity="0.001" integrator="RK4"/>
  <worldbody>
    <body name="left" pos="0 0 1">
      <joint name="a" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.3" contype="0"/>
      <body name="rod" pos="0 0 -0.3">
        <joint name="b" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.3" contype="0"/>
      </body>
    </body>
    <body name="right" pos="0.3 0 1">
      <joint name="c" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.3" contype="0"/>
    </body>
  </worldbody>
  <tendon>
    <fixed name="both"><joint joint="a" coef="1"/><joint joint="c" coef="0.5"/></fixed>
  </tendon>
  <equality><connect body1="rod" body2="right" anchor="0.3 0 0"/></equality>
  <actuator><motor name="pull" tendon="both" gear="2"/></actuator>
</mujoco>
"""
MODELS = {"hopper": HOPPER, "box": BOX, "loop": LOOP}


def plant_of_text(text: str, keyframe: str = "") -> MujocoPlant:
    """The plant of a model."""
    return mujoco_plant(mujoco.MjModel.from_xml_string(text), "robot", keyframe)
