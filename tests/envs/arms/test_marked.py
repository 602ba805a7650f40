"""What a camera logs of an arm with markers, and whether the model is that of the table."""

from __future__ import annotations

from dataclasses import replace
from math import cos, sin

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from envs.arms.marked import IDEAL, Camera, Link, random_links, random_marked_arm
from envs.arms.marked import arm as chain_model
from envs.arms.motions import RANGES, sinusoids


@pytest.fixture
def arm():
    return random_marked_arm(np.random.default_rng(0), 4)


def frames(count: int, arm, seed: int = 1):
    time = 0.1 * np.arange(count)
    return time, sinusoids(time, arm.kinds, np.random.default_rng(seed))


def pose(columns, marker: str) -> tuple[np.ndarray, Rotation]:
    values = np.stack([columns[f"{marker}_{end}"] for end in ("x", "y", "z")], -1)
    quaternions = np.stack([columns[f"{marker}_{end}"] for end in ("qw", "qx", "qy", "qz")], -1)
    return values, Rotation.from_quat(quaternions, scalar_first=True)


def test_a_perfect_camera_logs_the_truth_in_columns_that_hide_the_order(arm) -> None:
    time, q = frames(20, arm)
    columns = arm.log(time, q, IDEAL, np.random.default_rng(2))
    assert list(columns)[1:5] == ["q1", "q2", "q3", "q4"]
    assert list(columns)[5::7] == ["m0_x", "m1_x", "m2_x", "m3_x", "m4_x"]
    positions, orientations = arm.poses(q)
    for place, marker in enumerate(arm.markers):
        seen, turned = pose(columns, marker)
        np.testing.assert_allclose(seen, positions[:, place], atol=1e-12)
        difference = turned.inv() * orientations[place :: len(arm.markers)]
        assert difference.magnitude().max() < 1e-7
    for place, joint in enumerate(arm.joints):
        np.testing.assert_array_equal(columns[joint], q[:, place])


def test_noise_is_as_large_as_said_and_grows_beyond_the_reliable_distance(arm) -> None:
    time, q = frames(2000, arm)
    base = arm.markers[0]
    near, far = (
        arm.log(time, q, Camera(0.003, 0.01, reliable), np.random.default_rng(3))
        for reliable in (4.0, 1.0)
    )
    distance = np.linalg.norm(arm.poses(q[:1])[0][0, 0])
    assert 1.0 < distance < 4.0
    for columns, growth in ((near, 1.0), (far, distance**2)):
        seen, turned = pose(columns, base)
        assert seen.std(0) == pytest.approx(0.003 * growth, rel=0.1)
        turns = (turned * turned.mean().inv()).as_rotvec()
        assert turns.std(0) == pytest.approx(0.01 * growth, rel=0.1)


def test_so_many_poses_are_wrong_and_so_many_are_missing(arm) -> None:
    time, q = frames(2000, arm)
    camera = Camera(outliers=0.1, missing=0.2)
    columns = arm.log(time, q, camera, np.random.default_rng(4))
    seen, _ = pose({k: np.nan_to_num(v, nan=0.5) for k, v in columns.items()}, arm.markers[0])
    missing = np.isnan(columns[f"{arm.markers[0]}_x"])
    assert missing.mean() == pytest.approx(0.2, abs=0.03)
    error = np.linalg.norm(seen - np.median(seen[~missing], axis=0), axis=1)[~missing]
    assert (error > 0.05).mean() == pytest.approx(0.1, abs=0.03)


def test_equal_seeds_give_equal_logs(arm) -> None:
    time, q = frames(10, arm)
    first, again = (arm.log(time, q, Camera(), np.random.default_rng(5)) for _ in range(2))
    assert all(np.array_equal(first[name], again[name]) for name in first)


def test_motions_stay_in_their_ranges() -> None:
    kinds = ("hinge", "slide")
    q = sinusoids(0.1 * np.arange(300), kinds, np.random.default_rng(6))
    assert np.abs(q).max(0) == pytest.approx([RANGES[kind] for kind in kinds])


# --- tables of frames ---


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
    model = chain_model(links).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = q = rng.uniform(-2.0, 2.0, 6)
    mujoco.mj_kinematics(model, data)
    T = np.eye(4)
    for number, link in enumerate(links, start=1):
        T = T @ frame(link, q[number - 1])
        body = data.body(f"link{number}")
        np.testing.assert_allclose(body.xpos, T[:3, 3], atol=1e-12)
        np.testing.assert_allclose(body.xmat.reshape(3, 3), T[:3, :3], atol=1e-12)
