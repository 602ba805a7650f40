"""Logs of a small robot whose parameters are known."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from mcpilco.identification import RigidBody
from mcpilco.recordings import Recording, Segment, write_recording

XML = """<mujoco><compiler angle="radian"/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.3"/>
    <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.05" mass="2"/>
    <body name="clamp" pos="0.2 0 0.05"><geom type="box" size="0.02 0.03 0.01" mass="0.3"/></body>
    <body name="lower" pos="0.4 0 0"><joint name="elbow" axis="0 0.6 0.8" damping="0.2"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0.02" size="0.04" mass="1"/></body></body>
</worldbody><actuator>
  <motor name="shoulder_motor" joint="shoulder" gear="2"/>
  <motor name="elbow_motor" joint="elbow" ctrlrange="-30 30" ctrllimited="true"/>
</actuator></mujoco>"""
DT = 0.005
JOINTS = ("shoulder", "elbow")


def model() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(XML)


def heavier() -> mujoco.MjModel:
    """The robot that is recorded: not what its model says."""
    robot = model()
    robot.body_mass[[1, 3]] *= 1.5
    robot.body_inertia[[1, 3]] *= 1.4
    robot.dof_damping[:] = [0.5, 0.1]
    return robot


def segment(
    robot: mujoco.MjModel,
    seed: int = 0,
    seconds: float = 20.0,
    noise: float = 0.0,
    force_noise: float = 0.0,
) -> Segment:
    """Sinusoids of a robot, with the forces that they need."""
    rng, time = np.random.default_rng(seed), DT * np.arange(round(seconds / DT))
    w = 2.0 * np.pi * rng.uniform(0.3, 1.2, (2, 4))
    angle = w * time[:, None, None] + rng.uniform(0.0, 6.0, (2, 4))
    q, dq, ddq = (
        0.4 * wave.sum(axis=2)
        for wave in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle))
    )
    body = RigidBody.of(robot, ("viscous", "coulomb", "armature"))
    tau = body.regressor(q, dq, ddq) @ body.nominal
    measured = q + noise * rng.normal(size=q.shape)
    tau = tau + force_noise * rng.normal(size=q.shape)
    return Segment("log", DT, measured, np.full_like(q, np.nan), tau, q)


def write(path: Path, part: Segment, motors: bool = False) -> Path:
    """A CSV of torques, or of commands of the motors."""
    inputs = part.tau / np.array([2.0, 1.0]) if motors else part.tau
    kinds = "motor" if motors else "torque"
    recording = Recording(
        name=path.stem,
        time=part.dt * np.arange(len(part.q)),
        states=part.q,
        inputs=inputs,
        state_names=tuple(f"{joint}_position" for joint in JOINTS),
        input_names=tuple(f"{joint}_{kinds}" for joint in JOINTS),
    )
    return write_recording(path, recording)
