"""Robots to identify, as MJCF."""

from __future__ import annotations

import mujoco
import numpy as np

from mcpilco.identification import RigidBody

LINKS = (
    # where the next joint is in the frame of the one before [m], and how it is turned [rad]
    ((0.0, 0.0, 0.333), (0.0, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (-np.pi / 2, 0.0, 0.0)),
    ((0.0, -0.316, 0.0), (np.pi / 2, 0.0, 0.0)),
    ((0.0825, 0.0, 0.0), (np.pi / 2, 0.0, 0.0)),
    ((-0.0825, 0.384, 0.0), (-np.pi / 2, 0.0, 0.0)),
    ((0.0, 0.0, 0.0), (np.pi / 2, 0.0, 0.0)),
    ((0.088, 0.0, 0.0), (np.pi / 2, 0.0, 0.0)),
)
"""of an arm with seven hinges, the first of them upright"""


def arm(gravity: str = "0 0 -9.81") -> mujoco.MjModel:
    """Seven hinges; each link a capsule away from its joint's axis, with friction in the joint."""
    opened, closed = "", ""
    for number, (at, turned) in enumerate(LINKS):
        opened += (
            f'<body name="link{number}" pos="{_row(at)}" euler="{_row(turned)}">'
            f'<joint name="joint{number}" damping="{0.5 + 0.1 * number}" axis="0 0 1"/>'
            f'<geom type="capsule" fromto="0.01 0.02 0 0.03 {-0.1 + 0.02 * number} 0.08" '
            f'size="0.05" mass="{3.0 - 0.3 * number}" contype="0" conaffinity="0"/>'
        )
        closed += "</body>"
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian" eulerseq="xyz"/><option gravity="{gravity}"/>'
        f"<worldbody>{opened}{closed}</worldbody></mujoco>"
    )


def arm_body() -> RigidBody:
    """The arm with viscous friction alone, as in the seed: 77 parameters."""
    return RigidBody.of(arm(), terms=("viscous",))


def _row(numbers) -> str:
    return " ".join(map(repr, map(float, numbers)))
