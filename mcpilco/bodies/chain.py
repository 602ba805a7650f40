"""An open chain of rigid bodies: joints, frames, masses and inertias."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mcpilco.typing import InputError

HINGE: Literal["hinge"] = "hinge"
SLIDE: Literal["slide"] = "slide"

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
NOT_TURNED: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class Body:
    """A rigid body and the joint that holds it to its parent.

    The body's frame lies in the joint and moves with the body.
    """

    name: str
    """of the body"""
    joint: str
    """name of its joint"""
    kind: Literal["hinge", "slide"]
    """of its joint"""
    axis: Vector
    """of the joint, a unit vector in the body's frame [-]"""
    mass: float
    """[kg]"""
    parent: int = -1
    """which body it is held to, one that comes before it; -1 is the world"""
    origin: Vector = (0.0, 0.0, 0.0)
    """of the body's frame where the joint is at 0, in the parent's [m]"""
    rotation: Matrix = NOT_TURNED
    """R_pb where the joint is at 0: takes the body's frame to the parent's [-]"""
    center: Vector = (0.0, 0.0, 0.0)
    """center of mass, in the body's frame [m]"""
    inertia: Matrix = ((0.0, 0.0, 0.0),) * 3
    """about the center of mass, along the axes of the body's frame [kg m^2]"""
    armature: float = 0.0
    """inertia of the motor, reflected to the joint [kg m^2, or kg at a slide]"""


@dataclass(frozen=True)
class Chain:
    """J bodies, each on one joint; branches are allowed, loops are not."""

    bodies: tuple[Body, ...]
    """parents first"""
    gravity: Vector = (0.0, 0.0, -9.82)
    """[m/s^2]"""

    def __post_init__(self) -> None:
        for number, body in enumerate(self.bodies):
            if not -1 <= body.parent < number:
                raise InputError(
                    f"body {body.name!r} must come after its parent, got parent {body.parent} "
                    f"for body {number}; put parents first."
                )
            if not math.isclose(math.hypot(*body.axis), 1.0, rel_tol=1e-5):
                raise InputError(
                    f"the axis of joint {body.joint!r} must have length 1, got {body.axis}."
                )

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of q."""
        return tuple(body.joint for body in self.bodies)


class Chains(NamedTuple):
    """S chains of one shape as arrays, for the compiled loops: [units as in `Body`]."""

    parent: Int[np.ndarray, " J"]
    slides: Int[np.ndarray, " J"]
    """1 where the joint is a slide"""
    planar: Int[np.ndarray, " 1"]
    """1 where all bodies stay in the plane of x and z"""
    axis: Float[np.ndarray, "J 3"]
    rotation: Float[np.ndarray, "J 3 3"]
    origin: Float[np.ndarray, "S J 3"]
    mass: Float[np.ndarray, "S J"]
    center: Float[np.ndarray, "S J 3"]
    inertia: Float[np.ndarray, "S J 3 3"]
    armature: Float[np.ndarray, "S J"]
    gravity: Float[np.ndarray, "S 3"]


def stack(chains: Sequence[Chain], rows: Int[np.ndarray, " S"] | None = None) -> Chains:
    """Chains that differ in numbers only, one behind the other.

    Args:
        chains: these.
        rows: which of them stands where, for systems that share their bodies; by default each once.

    Raises:
        InputError: they differ in their joints.
    """
    first = chains[0].bodies
    shape = [(body.parent, body.kind, body.axis, body.rotation) for body in first]
    for chain in chains[1:]:
        if [(b.parent, b.kind, b.axis, b.rotation) for b in chain.bodies] != shape:
            raise InputError("chains can be stacked where their joints are equal; these differ.")

    rows = np.arange(len(chains)) if rows is None else rows
    numbers = {
        name: np.array([[getattr(b, name) for b in chain.bodies] for chain in chains], float)[rows]
        for name in ("origin", "mass", "center", "inertia", "armature")
    }
    return Chains(
        parent=np.array([body.parent for body in first]),
        slides=np.array([int(body.kind == SLIDE) for body in first]),
        planar=np.array([int(all(map(_planar, first)))]),
        axis=np.array([body.axis for body in first], float),
        rotation=np.array([body.rotation for body in first], float),
        gravity=np.array([chain.gravity for chain in chains], float)[rows],
        **numbers,
    )


def distinct_rows(
    rows: Float[np.ndarray, "S n"],
) -> tuple[Float[np.ndarray, "D n"], Int[np.ndarray, " S"]]:
    """The rows of a table that differ, in their order, and which of these each row is.

    For the few and short rows of a simulation, in a tenth of the time of `numpy.unique`.
    """
    numbers: dict[bytes, int] = {}
    which = np.array([numbers.setdefault(row.tobytes(), len(numbers)) for row in rows], np.int64)
    return rows[np.unique(which, return_index=True)[1]], which


def _planar(body: Body) -> bool:
    """Whether a body turns about y only, or slides across it."""
    R = np.array(body.rotation)
    turned_about_y = R[1, 1] == 1.0 and not R[1, [0, 2]].any() and not R[[0, 2], 1].any()
    about = abs(body.axis[1])
    return bool(turned_about_y) and about == (0.0 if body.kind == SLIDE else 1.0)
