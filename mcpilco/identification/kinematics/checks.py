"""What a recording must have before a chain or a model can be found in it."""

from __future__ import annotations

import numpy as np

from mcpilco.recordings import MarkerRecording
from mcpilco.typing import InputError

_TURNS = 50.0
"""a joint that spans more is probably in degrees [rad]"""
_LEAST_MOTION = 0.02
"""a joint that spans less is told as hardly moved [rad or m]"""


def check_recording(recording: MarkerRecording) -> list[str]:
    """Sentences on what looks wrong.

    Raises:
        InputError: nothing can be found in the recording; the sentence says what to record.
    """
    _require_samples(recording)
    _require_distinct(recording)
    _require_sight(recording)
    return _require_motion(recording)


def fewest(joints: int) -> int:
    """Two samples a joint, as few as can tell all triplets apart (thesis definition 2.3.4)."""
    return 2 * joints


def _require_samples(recording: MarkerRecording) -> None:
    markers, joints = len(recording.marker_names), len(recording.joint_names)
    if joints < markers - 1:
        raise InputError(
            f"{markers} markers in a chain need {markers - 1} joints, got {joints}; record the "
            "positions of all joints, or leave second markers of a link out."
        )
    if len(recording) < fewest(joints):
        raise InputError(
            f"expected at least {fewest(joints)} samples for {joints} joints, got "
            f"{len(recording)}; record each joint at many positions, 50 samples or more."
        )


def _require_distinct(recording: MarkerRecording) -> None:
    backwards = np.flatnonzero(np.diff(recording.time) <= 0)
    if len(backwards):
        k = int(backwards[0])
        raise InputError(
            f"samples {k} and {k + 1} have the times {recording.time[k]:g} and "
            f"{recording.time[k + 1]:g} s; time must rise: sort the rows, and remove repeated ones."
        )
    n = len(recording)
    poses = np.nan_to_num(recording.positions).reshape(n, -1)
    rows = np.concatenate(
        [recording.q, poses, np.nan_to_num(recording.quaternions).reshape(n, -1)], 1
    )
    _, first, counts = np.unique(rows, axis=0, return_index=True, return_counts=True)
    if len(first) < n:
        k = int(first[counts > 1].min())
        raise InputError(
            f"{n - len(first)} of {n} samples repeat another one to the last digit, as sample {k}; "
            "log each frame of the camera once, and remove the repetitions."
        )


def _require_sight(recording: MarkerRecording) -> None:
    least = fewest(len(recording.joint_names))
    for name, seen in zip(recording.marker_names, recording.seen.T, strict=True):
        if not seen.any():
            raise InputError(
                f"marker {name} is never seen; turn it to the camera, or leave its columns out "
                "together with the joint behind it."
            )
        if seen.sum() < least:
            raise InputError(
                f"marker {name} is seen in {seen.sum()} samples of {len(recording)}, expected at "
                f"least {least}; turn it to the camera."
            )


def _require_motion(recording: MarkerRecording) -> list[str]:
    sentences = []
    for name, q in zip(recording.joint_names, recording.q.T, strict=True):
        span = float(np.ptp(q))
        if span == 0:
            raise InputError(
                f"joint {name} is {q[0]:g} throughout, so its place in the chain cannot be seen; "
                "record it moving through its range, or leave its column out together with the "
                "marker behind it."
            )
        if span < _LEAST_MOTION:
            sentences.append(f"{name} spans only {span:.2g} rad or m; move it through its range.")
        if span > _TURNS:
            sentences.append(f"{name} spans {span:.0f}; is it in degrees? Expected rad or m.")
    return sentences
