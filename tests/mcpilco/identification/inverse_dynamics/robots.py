"""Robots whose inverse dynamics are to be learned, and what is measured of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from envs.arms.motions import random_motion
from mcpilco.bodies import SLIDE, Body, Chain, generalised_forces
from mcpilco.recordings import JointData


def random_robot(kinds: Sequence[str], rng: np.random.Generator) -> Chain:
    """Bodies of random size on joints about random axes, one behind the other."""

    def body(number: int, kind: str) -> Body:
        axis = rng.normal(size=3)
        points = rng.normal(0, 0.1, (10, 3))  # of mass, so that a body can have this inertia
        spread = points.T @ points
        return Body(
            name=f"body{number}",
            joint=f"joint{number}",
            kind=kind,
            axis=tuple(axis / np.linalg.norm(axis)),
            mass=rng.uniform(0.5, 2.0),
            parent=number - 1,
            origin=tuple(rng.normal(0, 0.3, 3)),
            rotation=tuple(map(tuple, Rotation.random(rng=rng).as_matrix())),
            center=tuple(rng.normal(0, 0.2, 3)),
            inertia=tuple(map(tuple, 0.1 * (np.trace(spread) * np.eye(3) - spread))),
        )

    return Chain(tuple(body(number, kind) for number, kind in enumerate(kinds)))


def measured(
    robot: Chain, rng: np.random.Generator, count: int, noise: float = 0.0, friction: float = 0.0
) -> JointData:
    """Independent motions that excite everything, and their torques."""
    shape = (count, len(robot.bodies))
    slides = np.array([body.kind == SLIDE for body in robot.bodies])
    q = rng.uniform(-1.0, 1.0, shape) * np.where(slides, 0.5, np.pi)
    dq, ddq = rng.normal(size=shape), 2.0 * rng.normal(size=shape)
    tau = generalised_forces(robot, q, dq, ddq) + noise * rng.normal(size=shape)
    tau += friction * (dq + np.tanh(dq / 0.02))
    return JointData(q, dq, ddq, tau, robot.joints, tuple(body.kind for body in robot.bodies))


def moved(robot: Chain, rng: np.random.Generator, count: int, dt: float = 0.01) -> JointData:
    """One smooth motion at steps of dt [s], and its torques."""
    motion = random_motion(robot, rng, count, dt)
    tau = generalised_forces(robot, *motion)
    return JointData(*motion, tau, robot.joints, tuple(body.kind for body in robot.bodies))
