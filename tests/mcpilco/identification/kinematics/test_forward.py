"""Forward kinematics is learned to the truth, kept in a file, and followed by the controller."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from envs.arms.marked import IDEAL, Camera, Link, MarkedArm, marked_arm
from mcpilco.files import read_groups, write_groups
from mcpilco.identification.kinematics import (
    ForwardKinematics,
    KinematicChain,
    Reach,
    find_chain,
    fit_forward,
    reach,
)
from mcpilco.identification.kinematics.controller import _rotation_vector
from mcpilco.recordings import MarkerRecording, marker_recording
from mcpilco.typing import InputError, RunFolderError

LINKS = (
    Link("hinge", d=0.3, alpha=np.pi / 2),
    Link("hinge", a=0.5),
    Link("slide", theta=0.4, alpha=1.0, d=0.2),
    Link("hinge", a=0.2),
)


def seen_by(
    camera: Camera, samples: int = 150, seed: int = 0
) -> tuple[MarkedArm, MarkerRecording, KinematicChain]:
    rng = np.random.default_rng(seed)
    arm = marked_arm(LINKS, rng)
    q = rng.uniform(-1.0, 1.0, (samples, 4)) * [1.5, 1.5, 0.3, 1.5]
    recording = marker_recording(arm.log(np.arange(float(samples)), q, camera, rng))
    return arm, recording, find_chain(recording)


def true_pose(arm: MarkedArm, q: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    positions, orientations = arm.poses(q)
    matrices = orientations.as_matrix().reshape(len(q), -1, 3, 3)
    return torch.as_tensor(positions[:, -1]), torch.as_tensor(matrices[:, -1])


def elsewhere(count: int) -> np.ndarray:
    rng = np.random.default_rng(9)
    return rng.uniform(-1.0, 1.0, (count, 4)) * [1.5, 1.5, 0.3, 1.5]


@pytest.fixture(scope="module")
def exact():
    arm, recording, chain = seen_by(IDEAL)
    return arm, recording, chain, fit_forward(recording, chain)


@pytest.mark.slow
@pytest.mark.parametrize("kernel", ["nested", "product"])
def test_without_noise_and_with_enough_samples_it_is_the_truth(exact, kernel: str) -> None:
    arm, recording, chain, model = exact
    if kernel != "nested":
        model = fit_forward(recording, chain, kernel=kernel)
    q = elsewhere(50)
    p, R = model.pose(torch.as_tensor(q))
    p_true, R_true = true_pose(arm, q)
    assert float((p - p_true).abs().max()) < 1e-4
    assert float((R - R_true).abs().max()) < 1e-4
    assert len(model.report.evidence) == 9


@pytest.mark.slow
def test_a_tenth_of_wrong_poses_is_found_and_left_out() -> None:
    arm, recording, chain = seen_by(Camera(0.003, 0.01, outliers=0.05, missing=0.05), 150, 1)
    model = fit_forward(recording, chain)
    q = elsewhere(100)
    p, R = model.pose(torch.as_tensor(q))
    p_true, R_true = true_pose(arm, q)
    assert float((p - p_true).square().mean().sqrt()) < 0.003
    turned = Rotation.from_matrix((R.mT @ R_true).numpy()).magnitude()
    assert np.sqrt((turned**2).mean()) < 0.02
    (sentence,) = (text for text in model.report.warnings if "contradict" in text)
    assert int(sentence.split()[0]) >= 5


@pytest.mark.slow
def test_file_holds_the_model(exact, tmp_path) -> None:
    model = exact[-1]
    again = ForwardKinematics.load(model.save(tmp_path / "forward.npz"))
    q = torch.as_tensor(elsewhere(5))
    for ours, theirs in zip(model.pose(q), again.pose(q), strict=True):
        torch.testing.assert_close(ours, theirs)
    assert (again.joints, again.kinds, again.marker) == (model.joints, model.kinds, model.marker)
    np.savez(tmp_path / "other.npz", about=np.array("{}"))
    with pytest.raises(RunFolderError, match="damaged"):
        ForwardKinematics.load(tmp_path / "other.npz")


def test_too_few_samples_are_refused(exact) -> None:
    _, recording, chain, _ = exact
    with pytest.raises(InputError, match="at least 10 samples .* got 5 of 150"):
        fit_forward(recording, chain, samples=5)
    with pytest.raises(InputError, match="kernel must be one of nested, product"):
        fit_forward(recording, chain, kernel="RBF")


def test_the_tip_comes_where_it_was_sent(exact) -> None:
    arm, *_, model = exact
    for goal in 0.8 * elsewhere(4):
        position, rotation = true_pose(arm, goal[None])
        path = reach(model, torch.zeros(4).double(), position[0], rotation[0])
        assert path.converged
        there = true_pose(arm, path.q[-1:].numpy())
        assert float((there[0] - position).norm()) < 1e-3
        assert float((there[1] - rotation).abs().max()) < 3e-3
        assert float(path.q.diff(dim=0).abs().max()) <= 0.05 + 1e-12
        assert float(path.q[0].abs().max()) == 0.0


def test_a_pose_out_of_reach_is_not_claimed(exact) -> None:
    model = exact[-1]
    far = torch.tensor([50.0, 0.0, 0.0]).double()
    path = reach(model, torch.zeros(4).double(), far, torch.eye(3).double(), Reach(steps=20))
    assert not path.converged
    assert path.position_error > 40.0
    inside = (path.q >= model.q.amin(0) - 1e-12) & (path.q <= model.q.amax(0) + 1e-12)
    assert bool(inside.all())


def test_reach_checks_its_numbers() -> None:
    with pytest.raises(InputError, match=r"Reach\.length must be positive, got 0"):
        dataclasses.replace(Reach(), length=0.0)


def test_rotation_vector_is_the_logarithm() -> None:
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(20, 3))
    vectors[0] = 0.0
    R = Rotation.from_rotvec(vectors).as_matrix()
    found = _rotation_vector(torch.as_tensor(R)).numpy()
    np.testing.assert_allclose(found, Rotation.from_matrix(R).as_rotvec(), atol=1e-9)


def test_a_file_that_says_revolute_and_prismatic_is_read(exact, tmp_path) -> None:
    model = exact[-1]
    about, groups = read_groups(model.save(tmp_path / "new.npz"))
    old = {"hinge": "revolute", "slide": "prismatic"}
    about["kinds"] = [old[kind] for kind in about["kinds"]]
    again = ForwardKinematics.load(write_groups(tmp_path / "old.npz", about, groups))
    assert again.kinds == model.kinds == ("hinge", "hinge", "slide", "hinge")
