"""Three tests of a triplet (marker, marker, joint): does the joint connect the markers' links?

For markers i and j, p is the position of j in the frame of i and R its orientation. Where the
triplet is connected, for some constants,

    P1  prismatic:  p = c + q u, |u| = 1, and R is constant      (thesis eq. 2.9)
    P2  revolute:   p = c + R d: a point stands still in both    (thesis eq. 2.12)
    P3  revolute:   R = A Rz(q) B                                (thesis eq. 2.13)

Each residual is a root mean square over samples and coordinates, so that it compares with the
standard deviation of the measurement: [m] for positions, [rad] for the components of a rotation
vector. Tests are for all pairs and joints at once.

Differs: P1 in closed form (the thesis minimises under a constraint); P2 by least squares of least
norm, since its matrix has rank 5 without noise, never 6 (the point may lie anywhere on the axis);
P3 by quaternions, whose residual has no singularity, in place of yaw, pitch and roll; R is constant
where its rotation from the mean is small, in place of a variance. The worst samples, by share,
count as outliers: in the thesis they have been removed before.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from mcpilco.identification.kinematics.residuals import (
    hinge,
    product,
    root_mean_square,
    rotated,
    slide,
    turn,
    weighted_mean,
)
from mcpilco.identification.kinematics.robust import trimmed
from mcpilco.recordings import MarkerRecording


@dataclass(frozen=True, eq=False)
class TripletTests:
    """Residuals of the tests for each pair of markers and each joint."""

    pairs: Int[np.ndarray, "pairs 2"]
    """numbers of the markers, the smaller first; who passes does not depend on the order"""
    slide: Float[np.ndarray, "pairs J"]
    """P1, position [m]"""
    rigid: Float[np.ndarray, " pairs"]
    """P1, orientation [rad]"""
    hinge: Float[np.ndarray, " pairs"]
    """P2 [m]"""
    turn: Float[np.ndarray, "pairs J"]
    """P3 [rad]"""


def triplet_tests(recording: MarkerRecording, outliers: float = 0.0) -> TripletTests:
    """All three tests for all triplets.

    Args:
        recording: of N samples; a pair is tested on those that show both markers.
        outliers: share of the samples of a pair that may be wrong [-]; the worst are not counted.
    """
    count = len(recording.marker_names)
    pairs = np.array(list(combinations(range(count), 2)))
    p, r, seen = _relative(recording, pairs)
    q = recording.q.T
    each = np.broadcast_to(seen[:, None], (len(pairs), *q.shape))
    constant = np.zeros((1, recording.q.shape[0]))
    return TripletTests(
        pairs=pairs,
        slide=trimmed(lambda w: slide(w, p, q), each, outliers),
        rigid=trimmed(lambda w: turn(w, r, constant), seen[:, None], outliers)[:, 0],
        hinge=trimmed(lambda w: hinge(w, p, r), seen, outliers),
        turn=trimmed(lambda w: turn(w, r, q), each, outliers),
    )


def standstill(
    recording: MarkerRecording, outliers: float = 0.0
) -> tuple[Float[np.ndarray, " markers"], Float[np.ndarray, " markers"]]:
    """How far each marker moves in the camera's frame: residuals [m] and [rad] of a constant."""
    p, seen = np.nan_to_num(recording.positions).swapaxes(0, 1), recording.seen.T.astype(float)
    r = np.nan_to_num(recording.quaternions, nan=0.5).swapaxes(0, 1)
    constant = np.zeros((1, len(recording)))
    position = trimmed(lambda w: root_mean_square(p - weighted_mean(w, p)), seen, outliers)
    orientation = trimmed(lambda w: turn(w, r, constant), seen[:, None], outliers)
    return position, orientation[:, 0]


def _relative(
    recording: MarkerRecording, pairs: Int[np.ndarray, "pairs 2"]
) -> tuple[
    Float[np.ndarray, "pairs N 3"], Float[np.ndarray, "pairs N 4"], Float[np.ndarray, "pairs N"]
]:
    """Relative positions and quaternions of all pairs, and 1 where both are seen, 0 elsewhere."""
    first, second = pairs.T
    seen = (recording.seen[:, first] & recording.seen[:, second]).T
    p = np.nan_to_num(recording.positions).swapaxes(0, 1)
    r = np.nan_to_num(recording.quaternions, nan=0.5).swapaxes(0, 1)
    back = r[first] * np.array([1.0, -1.0, -1.0, -1.0])
    return rotated(back, p[second] - p[first]), product(back, r[second]), seen.astype(float)
