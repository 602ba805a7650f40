"""Robots that are not quite what their drawings say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from envs.arms.frames import matrix, vector
from mcpilco.bodies import Body, Chain

LENGTH = 0.05
"""largest error of a length [m]"""
ANGLE = np.deg2rad(5.0)
"""largest error of an angle [rad]"""


def perturbed(
    chain: Chain, rng: np.random.Generator, length: float = LENGTH, angle: float = ANGLE
) -> Chain:
    """The chain with uniform errors in the four Denavit-Hartenberg parameters of each joint.

    Masses, centers of mass and inertias stay, each in the frame of its body.

    Args:
        chain: the robot as it was drawn.
        rng: what the errors are drawn from.
        length: largest error of the offsets along x and z of each frame [m].
        angle: largest error of the turns about x and z of each frame [rad].

    Reference: thesis section 3.4.1.
    """

    def of(body: Body) -> Body:
        x, z = rng.uniform(-length, length, 2)
        turn = Rotation.from_euler("xz", rng.uniform(-angle, angle, 2)).as_matrix()
        R = np.array(body.rotation) @ turn
        return replace(
            body,
            origin=vector(np.add(body.origin, (x, 0.0, z))),
            rotation=matrix(R),
        )

    return replace(chain, bodies=tuple(map(of, chain.bodies)))
