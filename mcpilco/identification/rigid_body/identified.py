"""From stretches of a robot's log to its parameters, with intervals, checks and errors.

A `Recipe` names the method of regression, the projection and the weights; `estimate` follows it on
rows, `identify` on recordings.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.stats import t as t_distribution

from mcpilco.identification.noisy_inputs import (
    METHODS,
    Moments,
    Solution,
    errors_in_variables,
    instrumental_variables,
    refine,
)
from mcpilco.identification.report import Report
from mcpilco.identification.rigid_body.body import (
    TERMS,
    BaseParameters,
    LinkCheck,
    RigidBody,
    base_parameters,
    check_links,
    random_motions,
)
from mcpilco.identification.rigid_body.projection import Projection, project, project_virtual
from mcpilco.identification.rigid_body.rows import Rows, force_errors, rows_of_segment
from mcpilco.recordings import Segment, encoder_noise, motion_cutoff
from mcpilco.typing import InputError

NEGLIGIBLE = 1e-10
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
"""methods that need more than inputs and outputs"""
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
    base: BaseParameters | None = None,
) -> Estimate:
    """The parameters of a robot.

    Each joint's rows are divided by `scale` [N m or N], where it is known; `base` are sums that the
    rows determine: all else stays nominal.

    Raises:
        InputError: the method needs what the rows do not have.
    """
    recipe = recipe or Recipe()
    if scale is None:
        scale = force_errors(rows) if recipe.rows == "weighted" else np.ones(rows.tau.shape[1])
    scaled = rows.scaled(scale)
    solution = solve(scaled, recipe.method, seed)
    raw = solution.b if base is None else base.near(base.of(solution.b), body.nominal)
    projection = PROJECTIONS[recipe.projection](body, raw, scaled.metric)
    return Estimate(projection.theta, raw, scale, solution, projection)


def solve(rows: Rows, method: str, seed: int = 0) -> Solution:
    """Parameters by one of `ALL_METHODS`, without a projection; the rows are taken as they are.

    A parameter that no force depends on is 0: of a column of rounding errors, some methods would
    make anything.

    Raises:
        InputError: the method needs what the rows do not have.
    """
    y, D = rows.tau.reshape(-1), rows.Y.shape[-1]
    length = np.linalg.norm(rows.Y.reshape(-1, D), axis=0)
    used = length > NEGLIGIBLE * length.max(initial=0.0)

    def columns(Y: np.ndarray) -> np.ndarray:
        return Y.reshape(-1, D)[:, used]

    def theta(b: np.ndarray) -> np.ndarray:
        whole = np.zeros(len(used))
        whole[used] = b
        return whole

    X = columns(rows.Y)
    if method in METHODS:
        size, of_y = np.ones(int(used.sum())), 1.0
        if method in ONE_LENGTH:
            size, of_y = length[used] / np.sqrt(len(y)), float(np.sqrt((y**2).mean())) or 1.0
        found = METHODS[method](X / size, y / of_y, seed)
        return replace(found, b=theta(found.b / size * of_y))
    if method == "EIV":
        if rows.noisier is None:
            raise InputError("EIV needs the noise of the rows; give it to Rows.of.")
        noise = columns(rows.noisier) - X
        return Solution(theta(errors_in_variables(Moments.of(X, y), noise.T @ noise / len(X))))
    if rows.reference is None:
        raise InputError(
            f"{method} needs the positions that were commanded; log a column <joint>_reference "
            "for each joint, or choose another method."
        )
    start = instrumental_variables(X, y, columns(rows.reference))
    if method == "IV":
        return Solution(theta(start))
    if (simulate := rows.simulate) is None:
        raise InputError("IDIM-IV needs a robot to simulate; give `simulate` to the rows.")
    found = refine(X, y, lambda b: columns(simulate(theta(b))), start)
    return replace(found, b=theta(found.b))


BLOCKS = 10
"""of rows, each left out once for the intervals"""
LEVEL = 0.95
"""of the intervals"""
QUANTILE = float(t_distribution.ppf(0.5 + 0.5 * LEVEL, BLOCKS - 1))
"""half of an interval, in standard deviations [-]"""
ROWS_A_PARAMETER = 10
"""least rows, all joints together, for each base parameter"""
WRITTEN = 1e-4
"""of a column's length, below which it depends on others [-]: axes have the six digits that MuJoCo
writes"""
MOVES = 10.0
"""range of a joint that moves, relative to its encoder's noise [-]"""
_RANDOM_MOTIONS = 400  # that base parameters are found from


@dataclass(frozen=True)
class Identified:
    """Parameters of a robot, and what the data say of them."""

    body: RigidBody
    """what theta belongs to"""
    recipe: Recipe
    """how it was found"""
    estimate: Estimate
    """theta, before and after the projection"""
    base: BaseParameters
    """the sums of parameters that forces depend on"""
    beta: Float[np.ndarray, " B"]
    """base parameters of theta"""
    covariance: Float[np.ndarray, "B B"]
    """of these: what chance may have done, not what the model lacks"""
    before: tuple[LinkCheck, ...]
    """link by link, consistency of the estimate"""
    after: tuple[LinkCheck, ...]
    """and with theta"""
    force: Float[np.ndarray, " J"]
    """root mean square of the forces in the held-out rows [N m or N]"""
    error: Float[np.ndarray, " J"]
    """of what theta leaves of them [N m or N]"""
    nominal_error: Float[np.ndarray, " J"]
    """of what the model as it was leaves of them [N m or N]"""
    cutoff: float
    """of the zero-phase filter [Hz]"""
    rows: tuple[int, int]
    """times that were fitted to, and that were held out"""

    @property
    def theta(self) -> Float[np.ndarray, " D"]:
        """The parameters, in the units of `body.units`."""
        return self.estimate.theta

    @property
    def half_width(self) -> Float[np.ndarray, " B"]:
        """Of the intervals of the base parameters."""
        return QUANTILE * np.sqrt(np.diag(self.covariance))

    @property
    def report(self) -> Report:
        """How the fit went, and what is vague."""
        base, recipe = self.base, self.recipe
        solution, projection = self.estimate.solution, self.estimate.projection
        summed = base.independent[(np.abs(base.K) > 1e-9).any(axis=1)]
        vague = int((self.half_width > np.abs(self.beta)).sum())
        warnings = []
        for what, search, count in (
            (recipe.method, solution, solution.iterations),
            (f"the projection {recipe.projection}", projection, projection.steps),
        ):
            if not search.converged:
                warnings.append(
                    f"{what} did not converge in {count} iterations: other parameters may be "
                    "better; choose another, or record faster and longer motions of all joints."
                )
        if vague:
            warnings.append(
                f"{vague} of {len(self.beta)} base parameters may be 0, by their intervals; faster "
                "and longer motions of all joints would determine them better."
            )
        alone = np.sort(np.concatenate([base.dependent, summed]))
        return Report(
            converged=solution.converged and projection.converged,
            iterations=solution.iterations + projection.steps,
            unidentified=tuple(np.array(self.body.names)[alone]),
            warnings=tuple(warnings),
        )


def identify(
    model: mujoco.MjModel,
    segments: Sequence[Segment],
    recipe: Recipe | None = None,
    *,
    terms: tuple[str, ...] = ("viscous", "coulomb"),
    filter: Literal["zero-phase", "local-cubics"] = "zero-phase",
    cutoff: float | None = None,
    held_out: float = 0.2,
    seed: int = 0,
) -> Identified:
    """The parameters of a robot from its recordings.

    What no force depends on, and what a joint has besides `terms`, stays as the model says.

    Args:
        model: joints, frames and gravity are taken from it, masses and friction are found.
        segments: of `mcpilco.identification.read_robot`.
        recipe: method, projection and weights.
        terms: what each joint has besides its body, keys of `TERMS`.
        filter: how derivatives are found.
        cutoff: of the zero-phase filter [Hz]; by default of `motion_cutoff`.
        held_out: share at the end of each stretch that is tested on [-].
        seed: of what is random in a method.

    Raises:
        InputError: the recordings are too short, a joint stands still, or an option cannot be
            meant.
    """
    if not 0.0 <= held_out <= 0.8:
        raise InputError(f"held_out must be between 0 and 0.8, got {held_out}.")
    recipe, body = recipe or Recipe(), RigidBody.of(model, terms)
    if not segments:
        raise InputError("at least one stretch of a recording was expected, got none.")
    cutoff = cutoff or float(np.median([motion_cutoff(s.q, s.dt) for s in segments]))
    _require_motion(body, segments)
    whole = RigidBody.of(model, tuple(TERMS))
    train, test, nominal = [], [], []
    simulated = model if recipe.method == "IDIM-IV" else None
    for segment in segments:
        motion, rows = rows_of_segment(body, whole, segment, filter, cutoff, simulated)
        split = len(rows) - round(held_out * len(rows))
        train.append(rows[:split])
        test.append(rows[split:])
        known = whole.regressor_of(motion) @ whole.nominal
        nominal.append((motion.tau - known)[split:])
    base = base_parameters(
        body.regressor(*random_motions(body, _RANDOM_MOTIONS, np.random.default_rng(0))), WRITTEN
    )
    rows, held = Rows.joined(train), Rows.joined(test)
    _require_rows(rows, base, segments)
    found = estimate(body, rows, recipe, seed=seed, base=base)
    covariance = _covariance(body, base, rows, recipe, found, seed)
    beta = base.of(found.theta)
    covariance += found.solution.common_std**2 * np.outer(beta, beta)
    judged = held if len(held) else rows
    return Identified(
        body=body,
        recipe=recipe,
        estimate=found,
        base=base,
        beta=beta,
        covariance=covariance,
        before=check_links(body, found.raw),
        after=check_links(body, found.theta),
        force=_rms(judged.tau),
        error=_rms(judged.tau - judged.Y @ found.theta),
        nominal_error=_rms(np.concatenate(nominal)) if len(held) else found.scale * np.nan,
        cutoff=cutoff,
        rows=(len(rows), len(held)),
    )


def _covariance(
    body: RigidBody, base: BaseParameters, rows: Rows, recipe: Recipe, found: Estimate, seed: int
) -> Float[np.ndarray, "B B"]:
    """Of the base parameters: standard deviations by leaving out one block of rows after another.

    Rows that follow one another share their errors; blocks hardly do. Ten blocks do not tell the
    correlations of more parameters: these are those of least squares, (X^T X)^-1.

    Reference: Shao, Tu, The jackknife and bootstrap, 1995, section 2.3 (delete-d jackknife).
    """
    scaled = rows.scaled(found.scale)
    if recipe.method == "IDIM-IV" and scaled.simulate is not None:
        # it keeps the instruments of its last simulation
        scaled = replace(scaled, reference=scaled.simulate(found.solution.b), simulate=None)
        recipe = replace(recipe, method="IV")
    block = np.arange(len(scaled)) * BLOCKS // len(scaled)
    parts = [scaled[block != left_out] for left_out in range(BLOCKS)]
    ones = np.ones(scaled.tau.shape[1])
    fits = [estimate(body, part, recipe, seed=seed, scale=ones, base=base) for part in parts]
    betas = np.array([base.of(fit.theta) for fit in fits])
    spread = np.sqrt((BLOCKS - 1) / BLOCKS * ((betas - betas.mean(axis=0)) ** 2).sum(axis=0))
    X = base.columns(scaled.Y).reshape(-1, len(base))
    X = X / np.linalg.norm(X, axis=0)
    inverse = np.linalg.pinv(X.T @ X, hermitian=True)
    size = np.sqrt(np.diag(inverse))
    return inverse / np.outer(size, size) * np.outer(spread, spread)


def _require_motion(body: RigidBody, segments: Sequence[Segment]) -> None:
    for j, joint in enumerate(body.chain.joints):
        span = max(float(np.ptp(segment.q[:, j])) for segment in segments)
        noise = max(float(encoder_noise(s.q, s.dt)[j]) for s in segments)
        if span <= MOVES * noise or span < 1e-9:
            raise InputError(
                f"joint {joint!r} must move, got positions within {span:.3g} of one another; "
                "record a motion of it, or weld it in the model."
            )
    if not any(segment.tau.any() for segment in segments):
        raise InputError("forces must not all be 0; log what the motors did.")


def _require_rows(rows: Rows, base: BaseParameters, segments: Sequence[Segment]) -> None:
    least = ROWS_A_PARAMETER * len(base)
    if rows.tau.size < least:
        seconds = sum(len(segment.q) * segment.dt for segment in segments)
        raise InputError(
            f"at least {least} rows were expected for {len(base)} base parameters, got "
            f"{rows.tau.size} from {seconds:.3g} s; record for longer."
        )


def _rms(values: Float[np.ndarray, "N J"]) -> Float[np.ndarray, " J"]:
    return np.sqrt((values**2).mean(axis=0))
