"""Chains are found whole, and what keeps one from being found is said."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from envs.arms.marked import Camera
from mcpilco.identification.kinematics import Tolerance, find_chain
from mcpilco.typing import InputError
from tests.mcpilco.identification.kinematics.robots import is_true, recorded


@pytest.mark.one_in(2)
@pytest.mark.parametrize("seed", range(10, 16))
def test_chain_is_exact_without_noise_and_with_it(seed: int) -> None:
    arm, recording = recorded(seed)
    assert is_true(find_chain(recording, Tolerance(1e-6, 1e-5, 0.0)), arm)
    arm, recording = recorded(seed, samples=60, camera=Camera(outliers=0.03, missing=0.1))
    found = find_chain(recording)
    assert is_true(found, arm)
    assert found.report.converged
    assert not found.report.warnings


def test_a_joint_that_connects_no_markers_is_unidentified() -> None:
    arm, recording = recorded(3)
    rng = np.random.default_rng(0)
    more = dataclasses.replace(
        recording,
        q=np.column_stack([rng.uniform(-1, 1, len(recording)), recording.q]),
        joint_names=("gripper", *recording.joint_names),
    )
    found = find_chain(more)
    assert is_true(found, arm)
    assert found.report.unidentified == ("gripper",)
    assert "gripper connect" in found.report.warnings[0]


def changed(**changes):
    _, recording = recorded(4, joints=3, samples=40)
    return dataclasses.replace(
        recording, **{name: change(getattr(recording, name)) for name, change in changes.items()}
    )


def constant(q):
    q = q.copy()
    q[:, 1] = 0.3
    return q


def unseen(values):
    values = values.copy()
    values[:, 2] = np.nan
    return values


def repeated(values):
    values = values.copy()
    values[7] = values[3]
    return values


@pytest.mark.parametrize(
    ("recording", "sentence"),
    [
        (changed(q=constant), "joint q2 is 0.3 throughout.*record it moving"),
        (changed(positions=unseen, quaternions=unseen), "marker m2 is never seen; turn it"),
        (changed(q=repeated, positions=repeated, quaternions=repeated), "1 of 40 samples repeat"),
        (changed(time=repeated), "samples 6 and 7 have the times.*time must rise"),
        (changed()[:4], "at least 6 samples for 3 joints, got 4; record each"),
        (changed(q=lambda q: q[:, :2], joint_names=lambda n: n[:2]), "need 3 joints, got 2"),
        (changed(q=lambda q: q[::-1]), "no chain passes the tests.*at .* times the tolerance"),
        (changed(positions=lambda p: p + np.arange(40)[:, None, None]), "no marker stands still"),
    ],
    ids=["constant", "never", "duplicates", "time", "few", "joints", "wrong", "moving"],
)
def test_bad_data_is_answered_with_what_to_record(recording, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        find_chain(recording)


def test_a_second_marker_on_the_base_is_refused() -> None:
    recording = changed()
    base = [recording.marker_names.index(find_chain(recording).base)]
    two = dataclasses.replace(
        recording,
        q=np.column_stack([recording.q, np.sin(recording.time)]),
        joint_names=(*recording.joint_names, "extra"),
        positions=np.concatenate([recording.positions, recording.positions[:, base]], 1),
        quaternions=np.concatenate([recording.quaternions, recording.quaternions[:, base]], 1),
        marker_names=(*recording.marker_names, "twin"),
    )
    with pytest.raises(InputError, match="twin stand still; only the base may"):
        find_chain(two)


def test_degrees_are_noticed() -> None:
    _, recording = recorded(4, joints=3, samples=40)
    degrees = dataclasses.replace(recording, q=np.degrees(recording.q))
    with pytest.raises(InputError, match=r"check units \(rad and m\)"):
        find_chain(degrees)


@pytest.mark.parametrize("wrong", [{"position": 0.0}, {"outliers": 0.5}])
def test_tolerances_are_checked(wrong) -> None:
    with pytest.raises(InputError, match="must be"):
        Tolerance(**wrong)
