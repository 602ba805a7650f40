"""The MuJoCo model of a table is the chain of frames that the table says."""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin

import mujoco
import numpy as np
import pytest

from envs.arms.dh import Link, arm, random_links


def frame(link: Link, q: float) -> np.ndarray:
    """Thesis eqs. (2.2) and (2.3), as a homogeneous matrix."""
    theta = link.theta + (q if link.kind == "hinge" else 0.0)
    d = link.d + (q if link.kind == "slide" else 0.0)
    c, s, ca, sa = cos(theta), sin(theta), cos(link.alpha), sin(link.alpha)
    return np.array(
        [
            [c, -s * ca, s * sa, link.a * c],
            [s, c * ca, -c * sa, link.a * s],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


@pytest.mark.parametrize("seed", range(5))
def test_every_frame_is_the_product_of_the_rows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    links = random_links(rng, 6)
    if seed == 0:
        links = tuple(replace(link, a=-link.a) for link in links)  # as in the table of a UR10
    model = arm(links).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = q = rng.uniform(-2.0, 2.0, 6)
    mujoco.mj_kinematics(model, data)
    T = np.eye(4)
    for number, link in enumerate(links, start=1):
        T = T @ frame(link, q[number - 1])
        body = data.body(f"link{number}")
        np.testing.assert_allclose(body.xpos, T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(body.xmat.reshape(3, 3), T[:3, :3], atol=1e-12)
