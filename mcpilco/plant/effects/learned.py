"""Forces in joints that were learned from recordings: cubic B-splines on grids, no formula.

A grid has one axis or two; each is a position, a velocity or the force of an actuator. A force is
twice differentiable, and 0 beyond two steps from its grid. An axis may be closed: behind its last
knot comes its first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit
from scipy.interpolate import BSpline

from mcpilco.bodies import INLINED, lane, lanes_of, with_lane
from mcpilco.plant.simulation.layout import Layout
from mcpilco.typing import InputError

FEWEST, MOST = 4, 200
"""knots of an axis"""


NONE = -1
"""in the place of the second axis of a grid that has one only"""


class Learned(NamedTuple):
    """K learned forces of S systems, over [q1, q1', q2, ..., force of input 1, ...]."""

    joint: Int[np.ndarray, " K"]
    """which each pushes"""
    axis: Int[np.ndarray, "K 2"]
    """what its grid is over"""
    slow: Float[np.ndarray, "K 2"]
    """where positive, the grid is even in asinh(x / slow)"""
    low: Float[np.ndarray, "K 2"]
    """of the first knot"""
    step: Float[np.ndarray, "K 2"]
    """from knot to knot"""
    knots: Int[np.ndarray, "K 2"]
    """of each axis"""
    closed: Bool[np.ndarray, "K 2"]
    """whether the first knot comes again, a step behind the last one"""
    weights: Float[np.ndarray, "S K M"]
    """of the splines, by first and second axis [N or N m]"""


def nothing(systems: int) -> Learned:
    """Of systems without learned forces."""
    pairs, counts = np.zeros((0, 2)), np.zeros((0, 2), dtype=np.int64)
    joint, closed = np.zeros(0, dtype=np.int64), np.zeros((0, 2), dtype=np.bool_)
    return Learned(joint, counts, pairs, pairs, pairs, counts, closed, np.zeros((systems, 0, 0)))


@dataclass(frozen=True)
class Axis:
    """One axis of a grid.

    Raises:
        InputError: it has no extent, too few or too many knots, or is closed and has slow speeds.
    """

    of: str
    """a state, or an input: then it is the force of its actuator at the joint"""
    low: float
    """of the first knot, in its unit"""
    high: float
    """of the last knot, in its unit"""
    knots: int
    """evenly spaced in x, or in asinh(x / slow)"""
    slow: float = 0.0
    """where positive, speeds about this one and below are spread out; 0: all places are alike"""
    closed: bool = False
    """whether the first knot comes again, a step behind the last one, as of an angle in a turn"""

    def __post_init__(self) -> None:
        ends = -1e100 < self.low < self.high < 1e100 and 0.0 <= self.slow < 1e100
        if not (ends and FEWEST <= self.knots <= MOST):
            raise InputError(
                f"the grid over {self.of} must have finite low < high, slow >= 0 and {FEWEST} to "
                f"{MOST} knots, got {self.low:g} to {self.high:g}, slow {self.slow:g}, "
                f"{self.knots} knots."
            )
        if self.closed and self.slow > 0.0:
            raise InputError(
                f"the grid over {self.of} must be even where it is closed, got slow {self.slow:g}."
            )

    def even(self, x: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "*b"]:
        """The coordinate in which the knots are evenly spaced."""
        return np.arcsinh(x / self.slow) if self.slow > 0.0 else x

    @property
    def places(self) -> Float[np.ndarray, " n"]:
        """The knots, in the even coordinate."""
        first, last = self.even(np.array([self.low, self.high]))
        return np.linspace(first, last, self.knots)

    @property
    def step(self) -> float:
        """From knot to knot, in the even coordinate."""
        return float(self.places[1] - self.places[0])

    @property
    def period(self) -> float:
        """Of a closed axis: after so much it comes round, in its unit."""
        return self.knots * self.step

    def once(self, x: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "*b"]:
        """The coordinate, on a closed axis brought to the turn that begins at its first knot."""
        return self.low + (x - self.low) % self.period if self.closed else x

    def apart(self) -> Float[np.ndarray, "n n"]:
        """How far knots are from one another, in the even coordinate; on a closed axis as chords.

        Reference: MacKay, Introduction to Gaussian processes (1998), section 4.
        """
        apart = self.places[:, None] - self.places
        if not self.closed:
            return apart
        return self.period / np.pi * np.sin(np.pi * apart / self.period)

    def splines(self, x: Float[np.ndarray, " N"]) -> Float[np.ndarray, "N n"]:
        """The cubic B-spline of each knot at some places, in the axis's unit."""
        basis = BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)
        t = (self.even(x)[:, None] - self.places) / self.step
        if self.closed:
            t -= self.knots * np.round(t / self.knots)
        return np.nan_to_num(basis(t))


@dataclass(frozen=True)
class LearnedForce:
    """A force in a joint as a function of one or two states or forces of actuators.

    It is a sum of cubic B-splines, which is 0 beyond two steps from its grid: where nothing was
    learned, nothing is added.

    Raises:
        InputError: no axis or more than two, or weights that are not finite or not one a knot.
    """

    joint: str
    """which it pushes"""
    axes: tuple[Axis, ...]
    """of its grid"""
    weights: tuple[float, ...]
    """of the splines, by first and second axis [N or N m]"""

    def __post_init__(self) -> None:
        if not 1 <= len(self.axes) <= 2:
            raise InputError(
                f"the learned force at {self.joint!r} must have one axis or two, "
                f"got {len(self.axes)}."
            )
        size = math.prod(axis.knots for axis in self.axes)
        if len(self.weights) != size or not all(abs(w) < 1e100 for w in self.weights):
            raise InputError(
                f"the learned force at {self.joint!r} must have {size} finite weights, one a "
                f"knot, got {len(self.weights)}."
            )

    def __str__(self) -> str:
        return f"learned force ({self.joint}; over {' and '.join(a.of for a in self.axes)})"

    def at(self, *x: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
        """The force at N places [N or N m].

        There are coordinates for each axis, in its unit.
        """
        return design(self.axes, x) @ np.array(self.weights)

    def require(self, layout: Layout) -> None:
        """Raises InputError where a plant has no such joint, state or input."""
        if self.joint not in layout.joints:
            raise InputError(
                f"a learned force cannot act at {self.joint!r}; "
                f"the joints are {', '.join(layout.joints)}."
            )
        for axis in self.axes:
            if axis.of not in (*layout.states, *layout.inputs):
                raise InputError(
                    f"a learned force cannot depend on {axis.of!r}; the states and inputs are "
                    f"{', '.join((*layout.states, *layout.inputs))}."
                )


def design(axes: Sequence[Axis], x: Sequence[Float[np.ndarray, " N"]]) -> Float[np.ndarray, "N M"]:
    """The splines of a grid at N places, so that their product with the weights is the force."""
    rows = axes[0].splines(x[0])
    for axis, more in zip(axes[1:], x[1:], strict=True):
        rows = (rows[:, :, None] * axis.splines(more)[:, None]).reshape(len(rows), -1)
    return rows


def tabulate(
    layout: Layout,
    forces: Sequence[tuple[str, tuple[Axis, ...]]],
    weights: Sequence[Float[np.ndarray, "S _"]],
    systems: int,
) -> Learned:
    """Learned forces as the compiled loops take them.

    Forces are joint and grid of each, weights those of each in S `systems`.
    """
    if not forces:
        return nothing(systems)
    names = (*layout.states, *layout.inputs)
    K, most = len(forces), max(w.shape[1] for w in weights)
    closed = np.zeros((K, 2), dtype=np.bool_)
    axis, knots = np.full((K, 2), NONE), np.ones((K, 2), dtype=np.int64)
    slow, low, step = np.zeros((K, 2)), np.zeros((K, 2)), np.ones((K, 2))
    table = np.zeros((systems, K, most))
    for k, (_, axes) in enumerate(forces):
        for a, one in enumerate(axes):
            axis[k, a], knots[k, a], slow[k, a] = names.index(one.of), one.knots, one.slow
            low[k, a], step[k, a], closed[k, a] = one.places[0], one.step, one.closed
        table[:, k, : weights[k].shape[1]] = weights[k]
    joint = np.array([layout.joints.index(name) for name, _ in forces], dtype=np.int64)
    return Learned(joint, axis, slow, low, step, knots, closed, table)


# For compiled callers. A spline has 16 terms at most at any place, whatever the grid.


@njit(**INLINED)
def place_on(learned, k, a, x):
    """Where a coordinate is on axis a of grid k, in steps from the first knot."""
    slow = learned.slow[k, a]
    for i in range(lanes_of(x) if slow > 0.0 else 0):
        x = with_lane(x, i, math.asinh(lane(x, i) / slow))
    place = (x - learned.low[k, a]) / learned.step[k, a]
    if learned.closed[k, a]:
        place -= learned.knots[k, a] * math.floor(place / learned.knots[k, a])
    return place


@njit(**INLINED)
def spline_weight(i, s):
    """The cubic B-spline whose knot is i - 1 knots further, at 0 <= s < 1 beyond a knot."""
    if i == 0:
        return (1.0 - s) ** 3 / 6.0
    if i == 1:
        return (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0
    if i == 2:
        return (-3.0 * s * s * s + 3.0 * s * s + 3.0 * s + 1.0) / 6.0
    return s * s * s / 6.0


@njit(**INLINED)
def learned_force(learned, s, k, x, y):
    """Force of grid k at x and y, steps from the first knots; y is 0 where there is one axis."""
    n, m = learned.knots[k, 0], learned.knots[k, 1]
    if not (-2.0 < x < n + 1.0 and -2.0 < y < m + 1.0):
        return 0.0
    i0, j0 = math.floor(x), math.floor(y)
    total = 0.0
    for i in range(4):
        row = i0 - 1 + i
        if learned.closed[k, 0]:
            row %= n
        if 0 <= row < n:
            if learned.axis[k, 1] < 0:
                part = learned.weights[s, k, row]
            else:
                part = 0.0
                for j in range(4):
                    column = j0 - 1 + j
                    if learned.closed[k, 1]:
                        column %= m
                    if 0 <= column < m:
                        weight = learned.weights[s, k, row * m + column]
                        part += spline_weight(j, y - j0) * weight
            total += spline_weight(i, x - i0) * part
    return total
