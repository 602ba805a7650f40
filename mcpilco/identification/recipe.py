"""From rows of a robot's motion to its parameters: weights, a method, a projection."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from mcpilco.identification.errors_in_variables import errors_in_variables
from mcpilco.identification.instruments import instrumental_variables
from mcpilco.identification.joint_motion import JointMotion
from mcpilco.identification.methods import METHODS
from mcpilco.identification.moments import Moments
from mcpilco.identification.projection import project
from mcpilco.identification.rigid_body import RigidBody
from mcpilco.identification.virtual import project_virtual
from mcpilco.typing import InputError

REFITS = 4
"""of the weights"""

FELT = 1e-10
"""length of a column, relative to the longest, below which it is rounding [-]"""

Project = Callable[[RigidBody, np.ndarray, np.ndarray], np.ndarray]
"""from parameters and the metric X^T X to consistent parameters"""

PROJECTIONS: Mapping[str, Project] = {
    "none": lambda body, estimate, metric: estimate,
    "virtual": project_virtual,
    "pseudo-inertia": lambda body, estimate, metric: project(body, estimate, metric).theta,
}
"""by name: as it is; eq. (5) of Ting et al.; positive semidefinite pseudo-inertias"""

NEEDS_MORE = ("EIV", "IV")
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
    """one of `ALL_METHODS`: of `METHODS`; EIV, errors in variables; IV, instrumental variables"""
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
class Rows:
    """A linear regression over all joints: N rows a joint, D parameters."""

    Y: Float[np.ndarray, "N J D"]
    """regressor"""
    tau: Float[np.ndarray, "N J"]
    """forces [N m or N]"""
    noisier: Float[np.ndarray, "N J D"] | None = None
    """regressor of the same motion with as much noise once more; for EIV"""
    reference: Float[np.ndarray, "N J D"] | None = None
    """regressor of the motion that was commanded, without noise; for IV"""

    def __len__(self) -> int:
        return len(self.Y)

    def __getitem__(self, rows: slice | np.ndarray) -> Rows:
        noisier = None if self.noisier is None else self.noisier[rows]
        reference = None if self.reference is None else self.reference[rows]
        return Rows(self.Y[rows], self.tau[rows], noisier, reference)

    @property
    def metric(self) -> Float[np.ndarray, "D D"]:
        """Y^T Y, in which a distance of parameters is a squared error of force."""
        return Moments.of(self.Y, self.tau).xx

    @classmethod
    def of(
        cls,
        body: RigidBody,
        motion: JointMotion,
        noise: JointMotion | None = None,
        reference: JointMotion | None = None,
    ) -> Rows:
        """Rows of a motion.

        Args:
            body: the robot.
            motion: as measured.
            noise: of the encoders, by the motion's filter.
            reference: as commanded, by the motion's filter.
        """
        noisier = None
        if noise is not None:
            more = replace(
                motion,
                q=motion.q + noise.q,
                dq=motion.dq + noise.dq,
                ddq=motion.ddq + noise.ddq,
            )
            noisier = more.regressor(body)
        commanded = None if reference is None else reference.regressor(body)
        return cls(motion.regressor(body), motion.tau, noisier, commanded)

    def scaled(self, scale: Float[np.ndarray, " J"]) -> Rows:
        """All divided by a number a joint."""
        by = scale[:, None]
        return Rows(
            self.Y / by,
            self.tau / scale,
            None if self.noisier is None else self.noisier / by,
            None if self.reference is None else self.reference / by,
        )


@dataclass(frozen=True)
class Estimate:
    """Parameters, before and after the projection."""

    theta: Float[np.ndarray, " D"]
    """after it, in the units of `RigidBody.units`"""
    raw: Float[np.ndarray, " D"]
    """before it"""
    scale: Float[np.ndarray, " J"]
    """what each joint's rows were divided by [N m or N]; 1 for plain rows"""


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
    return Estimate(PROJECTIONS[recipe.projection](body, raw, scaled.metric), raw, scale)


def force_errors(rows: Rows) -> Float[np.ndarray, " J"]:
    """Root mean square of what least squares leaves of each joint's force [N m or N].

    Found with rows divided by these errors themselves, so that a joint of small forces is fitted
    as closely, relative to its noise, as one of large forces.

    Reference: Gautier, Poignet, Extended Kalman filtering and weighted least squares dynamic
        identification of robot, Control Engineering Practice 9 (12), 2001.
    """
    least = 1e-9 * np.sqrt((rows.tau**2).mean(axis=0)) + 1e-300
    scale = np.maximum(rows.tau.std(axis=0), least)
    for _ in range(REFITS):
        b = Moments.of(rows.Y / scale[:, None], rows.tau / scale).least_squares()
        scale = np.maximum(np.sqrt(((rows.tau - rows.Y @ b) ** 2).mean(axis=0)), least)
    return scale


def solve(rows: Rows, method: str, seed: int = 0) -> Float[np.ndarray, " D"]:
    """Parameters by one of `ALL_METHODS`, without a projection; the rows are taken as they are.

    A parameter that no force depends on is 0: of a column of rounding errors, some methods would
    make anything.
    """
    X, y = rows.Y.reshape(-1, rows.Y.shape[-1]), rows.tau.reshape(-1)
    length = np.linalg.norm(X, axis=0)
    felt = length > FELT * length.max(initial=0.0)
    theta = np.zeros(len(felt))
    theta[felt] = _solve(
        X[:, felt],
        y,
        method,
        seed,
        *(
            None if Y is None else Y.reshape(X.shape)[:, felt]
            for Y in (rows.noisier, rows.reference)
        ),
    )
    return theta


def _solve(
    X: Float[np.ndarray, "M D"],
    y: Float[np.ndarray, " M"],
    method: str,
    seed: int,
    noisier: Float[np.ndarray, "M D"] | None,
    reference: Float[np.ndarray, "M D"] | None,
) -> Float[np.ndarray, " D"]:
    if method == "EIV":
        if noisier is None:
            raise InputError("EIV needs the noise of the rows; give it to Rows.of.")
        noise = noisier - X
        return errors_in_variables(Moments.of(X, y), noise.T @ noise / len(X))
    if method == "IV":
        if reference is None:
            raise InputError(
                "IV needs the positions that were commanded; log a column <joint>_reference for "
                "each joint, or choose another method."
            )
        return instrumental_variables(X, y, reference)
    return METHODS[method](X, y, seed)
