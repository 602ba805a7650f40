"""What a camera logs of an arm with markers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from envs.arms.marked import IDEAL, Camera, random_marked_arm
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
