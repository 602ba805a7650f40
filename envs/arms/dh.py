"""Serial arms from tables of Denavit and Hartenberg's parameters, as MuJoCo models."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Literal

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

Kind = Literal["hinge", "slide"]


@dataclass(frozen=True)
class Link:
    """A row of the table: the joint before a link, and the frame that it carries.

    The frame is reached from that of the link before by Rz(theta) Tz(d) Tx(a) Rx(alpha); the joint
    adds its position to theta or to d.

    Reference: thesis eqs. (2.2) and (2.3).
    """

    kind: Kind
    theta: float = 0.0
    """[rad]"""
    d: float = 0.0
    """[m]"""
    a: float = 0.0
    """[m]"""
    alpha: float = 0.0
    """[rad]"""


def random_links(rng: np.random.Generator, joints: int) -> tuple[Link, ...]:
    """A chain of hinges and slides in random order; some axes are parallel."""
    kinds: tuple[Kind, Kind] = ("hinge", "slide")
    return tuple(
        Link(
            kind=kinds[int(rng.integers(2))],
            theta=rng.uniform(-pi, pi),
            d=rng.uniform(-0.4, 0.4),
            a=rng.uniform(0.1, 0.4),
            alpha=float(rng.choice([0.0, pi / 2, -pi / 2, rng.uniform(-pi, pi)])),
        )
        for _ in range(joints)
    )


def arm(links: Sequence[Link]) -> mujoco.MjSpec:
    """A model with the bodies `link0`, which stands still, to `linkN`, and joints `joint1` to N.

    The frame of a body is the link's of the table, at q = 0.
    """
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="link0")
    for number, link in enumerate(links, start=1):
        turned = Rotation.from_euler("ZX", [link.theta, link.alpha])
        origin = np.array([link.a * np.cos(link.theta), link.a * np.sin(link.theta), link.d])
        body = body.add_body(
            name=f"link{number}", pos=origin, quat=turned.as_quat(scalar_first=True)
        )
        hinge = link.kind == "hinge"
        body.add_joint(
            name=f"joint{number}",
            type=mujoco.mjtJoint.mjJNT_HINGE if hinge else mujoco.mjtJoint.mjJNT_SLIDE,
            axis=turned.inv().apply([0.0, 0.0, 1.0]),  # the z axis of the frame before,
            pos=turned.inv().apply(-origin),  # through its origin
        )
        body.add_geom(size=[0.03, 0.0, 0.0], mass=1.0)
    return spec
