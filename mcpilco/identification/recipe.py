"""From rows of a robot's motion to its parameters: weights, a method, a projection."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from mcpilco.identification.errors_in_variables import errors_in_variables
from mcpilco.identification.instruments import instrumental_variables, refine
from mcpilco.identification.methods import METHODS
from mcpilco.identification.moments import Moments
from mcpilco.identification.projection import Projection, project
from mcpilco.identification.rigid_body import RigidBody
from mcpilco.identification.rows import Rows, force_errors
from mcpilco.identification.solution import Solution
from mcpilco.identification.virtual import project_virtual
from mcpilco.typing import InputError

FELT = 1e-10
"""length of a column, relative to the longest, below which it is rounding [-]"""

Project = Callable[[RigidBody, np.ndarray, np.ndarray], Projection]
"""from parameters and the metric X^T X to consistent parameters"""

PROJECTIONS: Mapping[str, Project] = {
    "none": lambda body, estimate, metric: Projection.none(body, estimate),
    "virtual": project_virtual,
    "pseudo-inertia": project,
}
"""by name: as it is; eq. (5) of Ting et al.; positive semidefinite pseudo-inertias"""

ONE_LENGTH = ("VB b_noise", "VB b_true")
"""methods whose prior compares all coefficients with 1: kg, kg m^2 and N m s need columns, and
forces, of one length, or what is small in its unit is pruned"""
NEEDS_MORE = ("EIV", "IV", "IDIM-IV")
"""methods that are told more than inputs and outputs"""
ALL_METHODS = (*METHODS, *NEEDS_MORE)
"""names of all methods"""


@dataclass(frozen=True)
class Recipe:
    """How parameters are found.

    What the defaults are worth, `runs/ting_robots` measures: weighted rows and a good filter much,
    the method little.
    """

    method: str = "EIV"
    """one of `ALL_METHODS`: of `METHODS`; EIV, errors in variables; IV, instrumental variables from
    the reference; IDIM-IV, from a simulation"""
    projection: str = "pseudo-inertia"
    """one of `PROJECTIONS`"""
    rows: Literal["weighted", "plain"] = "weighted"
    """weighted: each joint's rows by the error of its force, found by refitting"""

    def __post_init__(self) -> None:
        for name, value, known in (
            ("method", self.method, ALL_METHODS),
            ("projection", self.projection, tuple(PROJECTIONS)),
            ("rows", self.rows, ("weighted", "plain")),
        ):
            if value not in known:
                raise InputError(f"{name} must be one of {', '.join(known)}, got {value!r}.")


@dataclass(frozen=True)
class Estimate:
    """Parameters, before and after the projection."""

    theta: Float[np.ndarray, " D"]
    """after it, in the units of `RigidBody.units`"""
    raw: Float[np.ndarray, " D"]
    """before it"""
    scale: Float[np.ndarray, " J"]
    """what each joint's rows were divided by [N m or N]; 1 for plain rows"""
    solution: Solution
    """of the regression"""
    projection: Projection
    """of what it found"""


def estimate(
    body: RigidBody,
    rows: Rows,
    recipe: Recipe | None = None,
    *,
    seed: int = 0,
    scale: Float[np.ndarray, " J"] | None = None,
) -> Estimate:
    """The parameters of a robot.

    Args:
        body: what the parameters belong to.
        rows: of its motion.
        recipe: how they are found.
        seed: of the folds of cross validations.
        scale: what to divide each joint's rows by, where it is known [N m or N].

    Raises:
        InputError: the method needs what the rows do not have.
    """
    recipe = recipe or Recipe()
    if scale is None:
        scale = force_errors(rows) if recipe.rows == "weighted" else np.ones(rows.tau.shape[1])
    scaled = rows.scaled(scale)
    raw = solve(scaled, recipe.method, seed)
    found = PROJECTIONS[recipe.projection](body, raw.b, scaled.metric)
    return Estimate(found.theta, raw.b, scale, raw, found)


def solve(rows: Rows, method: str, seed: int = 0) -> Solution:
    """Parameters by one of `ALL_METHODS`, without a projection; the rows are taken as they are.

    A parameter that no force depends on is 0: of a column of rounding errors, some methods would
    make anything.

    Raises:
        InputError: the method needs what the rows do not have.
    """
    X, y = rows.Y.reshape(-1, rows.Y.shape[-1]), rows.tau.reshape(-1)
    length = np.linalg.norm(X, axis=0)
    felt = length > FELT * length.max(initial=0.0)

    def columns(Y: np.ndarray) -> np.ndarray:
        return Y.reshape(X.shape)[:, felt]

    def theta(b: np.ndarray) -> np.ndarray:
        whole = np.zeros(len(felt))
        whole[felt] = b
        return whole

    if method in METHODS:
        size, of_y = np.ones(int(felt.sum())), 1.0
        if method in ONE_LENGTH:
            size, of_y = length[felt] / np.sqrt(len(y)), float(np.sqrt((y**2).mean())) or 1.0
        found = METHODS[method](columns(rows.Y) / size, y / of_y, seed)
        found = replace(found, b=found.b / size * of_y)
    else:
        found = _solve_told(rows, method, columns, theta)
    return replace(found, b=theta(found.b))


def _solve_told(
    rows: Rows,
    method: str,
    columns: Callable[[np.ndarray], np.ndarray],
    theta: Callable[[np.ndarray], np.ndarray],
) -> Solution:
    """By one of `NEEDS_MORE`, of the columns that are felt."""
    X, y, simulate = columns(rows.Y), rows.tau.reshape(-1), rows.simulate
    if method == "EIV":
        if rows.noisier is None:
            raise InputError("EIV needs the noise of the rows; give it to Rows.of.")
        noise = columns(rows.noisier) - X
        return Solution(errors_in_variables(Moments.of(X, y), noise.T @ noise / len(X)))
    if rows.reference is None:
        raise InputError(
            f"{method} needs the positions that were commanded; log a column <joint>_reference "
            "for each joint, or choose another method."
        )
    start = instrumental_variables(X, y, columns(rows.reference))
    if method == "IV":
        return Solution(start)
    if simulate is None:
        raise InputError("IDIM-IV needs a robot to simulate; give `simulate` to the rows.")
    return refine(X, y, lambda b: columns(simulate(theta(b))), start)
