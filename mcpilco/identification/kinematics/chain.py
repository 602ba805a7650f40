"""The kinematic structure of a robot: its markers and joints in order, and the joints' kinds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from mcpilco.identification.kinematics.triplets import TripletTests, standstill, triplet_tests
from mcpilco.identification.report import Report
from mcpilco.kernels import Kind
from mcpilco.recordings import MarkerRecording
from mcpilco.typing import InputError

Scores = Float[np.ndarray, "markers markers J"]
"""residuals in parts of the tolerances, by both markers, in either order"""

_TURNS = 50.0
"""a joint that spans more is probably in degrees [rad]"""
_LEAST_MOTION = 0.02
"""a joint that spans less is reported as hardly moved [rad or m]"""


def fewest(joints: int) -> int:
    """Two samples a joint, the fewest that distinguish all triplets (thesis definition 2.3.4)."""
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
    """Sentences on what looks wrong in motions that are large enough."""
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


LARGEST = 500
"""samples that the tests look at; of longer recordings, so many at equal distances"""


@dataclass(frozen=True)
class Tolerance:
    """Thresholds between noise and a wrong triplet: about five times the noise of a pose."""

    position: float = 0.02
    """largest residual of positions, xi_t of thesis section 2.4.3 [m]"""
    orientation: float = 0.1
    """largest residual of orientations, xi_o [rad]"""
    outliers: float = 0.2
    """share of the samples of two markers that may be wrong; the worst are not counted [-]"""

    def __post_init__(self) -> None:
        if not (self.position > 0 and self.orientation > 0):
            raise InputError(
                f"tolerances must be positive, got {self.position} m and {self.orientation} rad."
            )
        if not 0 <= self.outliers < 0.5:
            raise InputError(
                f"the share of outliers must be at least 0 and below 0.5, got {self.outliers}."
            )


@dataclass(frozen=True)
class ChainJoint:
    """A joint of the chain, and the marker on the link behind it."""

    name: str
    kind: Kind
    marker: str
    position_residual: float
    """of its test, P1 or P2 [m]"""
    orientation_residual: float
    """of its test, P1 or P3 [rad]"""


@dataclass(frozen=True)
class KinematicChain:
    """An open kinematic chain, from the link that stands still to the last one.

    Reference: S_M, S_Q and S_q of thesis section 2.2.
    """

    base: str
    """marker of the link that stands still"""
    joints: tuple[ChainJoint, ...]
    """in order, each with the next link's marker"""
    tests: TripletTests = field(repr=False, compare=False)
    """residuals of all triplets"""
    report: Report = field(repr=False, compare=False)

    @property
    def markers(self) -> tuple[str, ...]:
        """From the base to the last link."""
        return (self.base, *(joint.marker for joint in self.joints))


def find_chain(recording: MarkerRecording, tolerance: Tolerance | None = None) -> KinematicChain:
    """The chain in which all neighbours pass the tests, from the marker that stands still.

    Where several chains pass, the one of least residuals is returned, and the report warns.

    Markers are on every link, every joint is moved; in any order.

    Raises:
        InputError: the recording is too poor, or no chain passes; the sentence says how far one
            gets and what to record.

    Reference: thesis section 2.4, figure 2.3.
    Differs: all triplets are tested before the search, which goes back where a path ends; the
    thesis takes the first marker and joint that pass.
    """
    tolerance = tolerance or Tolerance()
    _require_samples(recording)
    _require_distinct(recording)
    _require_sight(recording)
    warnings = _require_motion(recording)
    step = -(-len(recording) // LARGEST)
    recording = recording[::step]
    base = _base(recording, tolerance)
    tests = triplet_tests(recording, tolerance.outliers)
    slides, turns = scores(tests, tolerance)
    both: Scores = np.full((*[len(recording.marker_names)] * 2, slides.shape[1]), np.inf)
    first, second = tests.pairs.T
    both[first, second] = both[second, first] = np.minimum(slides, turns)
    paths = list(_paths(both, base, recording))
    best = min(paths, key=lambda path: sum(both[a, m, k] for (a, _), (m, k) in pairwise(path)))
    if len(paths) > 1:
        warnings.append(
            f"{len(paths)} chains pass the tests; this is the one of least residuals. Move each "
            "joint through more of its range, and all of them independently."
        )
    joints = []
    for (before, _), (marker, k) in pairwise(best):
        pair = int(np.flatnonzero((tests.pairs == sorted((before, marker))).all(1))[0])
        kind: Kind = "slide" if slides[pair, k] < turns[pair, k] else "hinge"
        residuals = tests.hinge[pair], tests.turn[pair, k]
        if kind == "slide":
            residuals = tests.slide[pair, k], tests.rigid[pair]
        name, behind = recording.joint_names[k], recording.marker_names[marker]
        joints.append(ChainJoint(name, kind, behind, *map(float, residuals)))
    used = {joint.name for joint in joints}
    unused = tuple(name for name in recording.joint_names if name not in used)
    if unused:
        warnings.append(f"{', '.join(unused)} connect no two markers and are left out.")
    report = Report(True, 0, unidentified=unused, warnings=tuple(warnings))
    return KinematicChain(recording.marker_names[base], tuple(joints), tests, report)


_Hop = tuple[int, int]
"""a marker, and the joint before it; -1 for the base"""


def _base(recording: MarkerRecording, tolerance: Tolerance) -> int:
    """The marker that stands still."""
    position, orientation = standstill(recording, tolerance.outliers)
    score = np.maximum(position / tolerance.position, orientation / tolerance.orientation)
    still = np.flatnonzero(score < 1)
    names = recording.marker_names
    if not len(still):
        nearest = int(score.argmin())
        raise InputError(
            f"no marker stands still: {names[nearest]} moves least, by {position[nearest]:.3g} m "
            f"and {orientation[nearest]:.3g} rad; fix the camera, put a marker on the base, or "
            "raise the tolerances above the noise."
        )
    if len(still) > 1:
        raise InputError(
            f"{' and '.join(names[marker] for marker in still)} stand still; only the base may: "
            "move the joint between them, and take off second markers of a link."
        )
    return int(still[0])


def scores(
    tests: TripletTests, tolerance: Tolerance
) -> tuple[Float[np.ndarray, "pairs J"], Float[np.ndarray, "pairs J"]]:
    """Residuals in parts of the tolerances, as slide and as hinge; below 1 passes."""
    rigid, hinge = tests.rigid[:, None], tests.hinge[:, None]
    slides = np.maximum(tests.slide / tolerance.position, rigid / tolerance.orientation)
    return slides, np.maximum(hinge / tolerance.position, tests.turn / tolerance.orientation)


def _paths(scores: Scores, base: int, recording: MarkerRecording) -> Iterator[list[_Hop]]:
    """All chains through every marker whose triplets pass."""
    longest: list[_Hop] = [(base, -1)]
    found = False
    open_paths: list[list[_Hop]] = [[(base, -1)]]
    while open_paths:
        path = open_paths.pop()
        longest = max(longest, path, key=len)
        if len(path) == len(scores):
            found = True
            yield path
            continue
        markers, joints = {m for m, _ in path}, {k for _, k in path}
        open_paths += [
            [*path, (int(m), int(k))]
            for m, k in np.argwhere(scores[path[-1][0]] < 1)
            if m not in markers and k not in joints
        ]
    if not found:
        raise InputError(_dead_end(scores, longest, recording))


def _dead_end(scores: Scores, path: list[_Hop], recording: MarkerRecording) -> str:
    """Where the longest chain ends, and what is nearest to going on."""
    markers, joints = recording.marker_names, recording.joint_names
    rest = scores[path[-1][0]].copy()
    rest[[m for m, _ in path]] = np.inf
    rest[:, [k for _, k in path[1:]]] = np.inf
    m, k = np.unravel_index(int(rest.argmin()), rest.shape)
    way = " ".join(f"-{joints[k]}- {markers[m]}" for m, k in path[1:])
    return (
        f"no chain passes the tests: it goes {markers[path[0][0]]} {way}".rstrip()
        + f" and ends there; nearest is {joints[k]} to {markers[m]}, at {rest[m, k]:.2g} times "
        "the tolerance. Put a marker on every link, record every joint, check units (rad and m) "
        "and that camera and joints share a clock; then raise the tolerances, if noise is larger."
    )
