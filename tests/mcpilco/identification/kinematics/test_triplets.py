"""The tests of triplets tell connected ones from all others."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from envs.arms.marked import IDEAL, Camera, Link, MarkedArm, marked_arm
from mcpilco.identification.kinematics import triplet_tests
from mcpilco.recordings import MarkerRecording, marker_recording
from tests.mcpilco.identification.kinematics.robots import recorded

EXACT, NOISY = (1e-6, 1e-5), (0.02, 0.1)


def labels(arm: MarkedArm, recording: MarkerRecording, pairs: np.ndarray, kind: str) -> np.ndarray:
    """Which pairs and joints are connected by a joint of this kind."""
    found = np.zeros((len(pairs), len(arm.joints)), dtype=bool)
    links = zip(arm.markers, arm.markers[1:], arm.joints, arm.kinds, strict=False)
    for first, second, joint, its_kind in links:
        pair = sorted(recording.marker_names.index(name) for name in (first, second))
        row = np.flatnonzero((pairs == pair).all(1))
        found[row, recording.joint_names.index(joint)] = its_kind == kind
    return found


@pytest.mark.parametrize(
    ("camera", "outliers", "limits"),
    [(IDEAL, 0.0, EXACT), (Camera(), 0.0, NOISY), (Camera(outliers=0.05, missing=0.1), 0.2, NOISY)],
    ids=["noise-free", "noisy", "outliers"],
)
@pytest.mark.parametrize("seed", range(4))
def test_p1_and_p2_with_p3_are_never_wrong_and_p2_alone_is(camera, outliers, limits, seed) -> None:
    arm, recording = recorded(seed, samples=60, camera=camera)
    tests = triplet_tests(recording, outliers)
    position, orientation = limits
    slide = (tests.slide < position) & (tests.rigid < orientation)[:, None]
    hinge = np.repeat((tests.hinge < position)[:, None], 5, axis=1)
    turning = hinge & (tests.turn < orientation)
    truth = labels(arm, recording, tests.pairs, "hinge")
    np.testing.assert_array_equal(slide, labels(arm, recording, tests.pairs, "slide"))
    np.testing.assert_array_equal(turning, truth)
    assert (hinge & ~truth).any() == truth.any()


def test_two_positions_of_each_joint_suffice() -> None:
    """The set of thesis definition 2.3.4."""
    rng = np.random.default_rng(0)
    links = [Link("hinge" if k % 2 else "slide", *rng.uniform(-1, 1, 4)) for k in range(5)]
    arm = marked_arm(links, rng)
    q = np.repeat(rng.uniform(-1, 1, (1, 5)), 10, axis=0)
    for joint in range(5):
        q[2 * joint + 1, joint] += 0.7
        q[2 * joint : 2 * joint + 2] += 1e-9 * joint  # no row twice
    recording = marker_recording(arm.log(np.arange(10.0), q, IDEAL, rng))
    tests = triplet_tests(recording)
    truth = labels(arm, recording, tests.pairs, "hinge")
    np.testing.assert_array_equal((tests.hinge < 1e-6)[:, None] & (tests.turn < 1e-5), truth)
    slides = (tests.slide < 1e-6) & (tests.rigid < 1e-5)[:, None]
    np.testing.assert_array_equal(slides, labels(arm, recording, tests.pairs, "slide"))


def test_residuals_depend_neither_on_the_order_of_markers_nor_on_full_turns() -> None:
    arm, recording = recorded(1, joints=3, samples=30)
    tests = triplet_tests(recording)
    turned = recording.q + 2 * np.pi * np.array([-1, 0, 2]) * (np.array(arm.kinds) == "hinge")
    flipped = dataclasses.replace(
        recording,
        q=recording.q if "slide" in arm.kinds else turned,
        positions=recording.positions[:, ::-1],
        quaternions=-recording.quaternions[:, ::-1],
        marker_names=recording.marker_names[::-1],
    )
    again = triplet_tests(flipped)
    order = [
        int(np.flatnonzero((again.pairs == sorted(3 - pair)).all(1))[0]) for pair in tests.pairs
    ]
    np.testing.assert_array_equal(again.slide[order] < 1e-6, tests.slide < 1e-6)
    for name in ("rigid", "turn"):
        np.testing.assert_allclose(
            getattr(again, name)[order], getattr(tests, name), rtol=1e-6, atol=1e-9
        )


def test_noise_is_what_is_left_of_a_connected_pair() -> None:
    arm, recording = recorded(2, samples=400, camera=Camera(0.003, 0.01))
    tests = triplet_tests(recording)
    pairs = [
        int(
            np.flatnonzero((tests.pairs == sorted(map(recording.marker_names.index, two))).all(1))[
                0
            ]
        )
        for two in zip(arm.markers, arm.markers[1:], strict=False)
    ]
    for pair, joint, kind in zip(pairs, arm.joints, arm.kinds, strict=True):
        k = recording.joint_names.index(joint)
        turn = tests.rigid[pair] if kind == "slide" else tests.turn[pair, k]
        assert turn == pytest.approx(0.01 * np.sqrt(2), rel=0.1)
