"""From stretches of a robot's log to its parameters, with all that can be said of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.stats import t as t_distribution

from mcpilco.identification.base_parameters import BaseParameters, base_parameters
from mcpilco.identification.consistency import LinkCheck, check
from mcpilco.identification.joint_motion import (
    JointMotion,
    encoder_noise,
    local_cubics,
    motion_cutoff,
    zero_phase,
)
from mcpilco.identification.recipe import (
    PROJECTIONS,
    Estimate,
    Recipe,
    Rows,
    force_errors,
    solve,
)
from mcpilco.identification.report import Report
from mcpilco.identification.rigid_body import TERMS, RigidBody, motions, rigid_body
from mcpilco.identification.robot_log import Segment
from mcpilco.typing import InputError

BLOCKS = 10
"""of rows, each left out once for the intervals"""
LEVEL = 0.95
"""of the intervals"""
ROWS_A_PARAMETER = 10
"""least rows, all joints together, for each base parameter"""
MOVES = 10.0
"""range of a joint that moves, relative to its encoder's noise [-]"""
_RANDOM_MOTIONS = 400  # that base parameters are told from


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
    """what forces can tell at all"""
    beta: Float[np.ndarray, " B"]
    """base parameters of theta"""
    half_width: Float[np.ndarray, " B"]
    """of their intervals: what chance may have done, not what the model lacks"""
    before: tuple[LinkCheck, ...]
    """link by link, what is wrong with the estimate"""
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
    report: Report
    """what to know of the fit"""

    @property
    def theta(self) -> Float[np.ndarray, " D"]:
        """The parameters, in the units of `body.units`."""
        return self.estimate.theta


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
    recipe, body = recipe or Recipe(), rigid_body(model, terms)
    if not segments:
        raise InputError("at least one stretch of a recording was expected, got none.")
    cutoff = cutoff or float(np.median([motion_cutoff(s.q, s.dt) for s in segments]))
    _require_motion(body, segments)
    whole = rigid_body(model, tuple(TERMS))
    train, test, nominal = [], [], []
    for segment in segments:
        motion, rows = _rows(body, whole, segment, filter, cutoff)
        split = len(rows) - round(held_out * len(rows))
        train.append(rows[:split])
        test.append(rows[split:])
        known = motion.regressor(whole) @ whole.nominal
        nominal.append((motion.tau - known)[split:])
    base = base_parameters(
        body.regressor(*motions(body, _RANDOM_MOTIONS, np.random.default_rng(0)))
    )
    rows, held = _joined(train), _joined(test)
    _require_rows(rows, base, segments)
    scale = force_errors(rows) if recipe.rows == "weighted" else np.ones(rows.tau.shape[1])
    scaled = rows.scaled(scale)
    found = _fit(body, base, scaled, recipe, seed)
    half = _half_widths(body, base, scaled, recipe, seed)
    beta = base.of(found.theta)
    judged = held if len(held) else rows
    return Identified(
        body=body,
        recipe=recipe,
        estimate=Estimate(found.theta, found.raw, scale),
        base=base,
        beta=beta,
        half_width=half,
        before=check(body, found.raw),
        after=check(body, found.theta),
        force=_rms(judged.tau),
        error=_rms(judged.tau - judged.Y @ found.theta),
        nominal_error=_rms(np.concatenate(nominal)) if len(held) else np.full(len(scale), np.nan),
        cutoff=cutoff,
        rows=(len(rows), len(held)),
        report=_report(body, base, beta, half),
    )


def _rows(
    body: RigidBody, whole: RigidBody, segment: Segment, filter: str, cutoff: float
) -> tuple[JointMotion, Rows]:
    """A stretch's motion, and its rows without the forces that the model is right about."""
    unknown, nothing = np.full_like(segment.q, np.nan), np.zeros_like(segment.q)
    step = max(1, int(1.0 / (8.0 * cutoff * segment.dt)))

    def filtered(q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> JointMotion:
        try:
            if filter == "zero-phase":
                return zero_phase(q, dq, tau, segment.dt, cutoff)
            return local_cubics(q, dq, tau, segment.dt, step=step)
        except InputError as error:
            raise InputError(f"{segment.name}: {error}") from None

    motion = filtered(segment.q, segment.dq, segment.tau)
    noise = np.random.default_rng(0).normal(size=segment.q.shape)
    noise *= encoder_noise(segment.q, segment.dt)
    told = np.isfinite(segment.dq).any(axis=0)  # a velocity's noise is not that of a derivative
    commanded = None
    if segment.reference is not None:
        commanded = filtered(segment.reference, unknown, nothing)
    rows = Rows.of(
        body, motion, filtered(noise, np.where(told, 0.0, np.nan) + nothing, nothing), commanded
    )
    return motion, replace(rows, tau=motion.tau - _left_out(body, whole, motion))


def _left_out(body: RigidBody, whole: RigidBody, motion: JointMotion) -> Float[np.ndarray, "N J"]:
    """Forces of the terms that are not to be found, with the model's values."""
    kept = [name in body.terms for name in whole.terms]
    values = whole.nominal.reshape(-1, whole.width).copy()
    values[:, : -len(kept)] = 0.0
    values[:, -len(kept) :][:, kept] = 0.0
    return motion.regressor(whole) @ values.ravel() if values.any() else np.zeros_like(motion.tau)


def _joined(parts: Sequence[Rows]) -> Rows:
    def all_of(name: str) -> np.ndarray | None:
        arrays = [getattr(part, name) for part in parts]
        return None if any(array is None for array in arrays) else np.concatenate(arrays)

    Y, tau = (np.concatenate([getattr(part, name) for part in parts]) for name in ("Y", "tau"))
    return Rows(Y, tau, all_of("noisier"), all_of("reference"))


def _fit(
    body: RigidBody, base: BaseParameters, scaled: Rows, recipe: Recipe, seed: int
) -> Estimate:
    """Parameters of rows that are scaled already; what they do not tell stays nominal."""
    raw = base.near(base.of(solve(scaled, recipe.method, seed)), body.nominal)
    theta = PROJECTIONS[recipe.projection](body, raw, scaled.metric)
    return Estimate(theta, raw, np.ones(scaled.tau.shape[1]))


def _half_widths(
    body: RigidBody, base: BaseParameters, scaled: Rows, recipe: Recipe, seed: int
) -> Float[np.ndarray, " B"]:
    """Of intervals for the base parameters, by leaving out one block of rows after another.

    Rows that follow one another share their errors; blocks hardly do.

    Reference: Shao, Tu, The jackknife and bootstrap, 1995, section 2.3 (delete-d jackknife).
    """
    block = np.arange(len(scaled)) * BLOCKS // len(scaled)
    betas = np.array(
        [
            base.of(_fit(body, base, scaled[block != left_out], recipe, seed).theta)
            for left_out in range(BLOCKS)
        ]
    )
    spread = np.sqrt((BLOCKS - 1) / BLOCKS * ((betas - betas.mean(axis=0)) ** 2).sum(axis=0))
    return float(t_distribution.ppf(0.5 + 0.5 * LEVEL, BLOCKS - 1)) * spread


def _report(
    body: RigidBody,
    base: BaseParameters,
    beta: Float[np.ndarray, " B"],
    half: Float[np.ndarray, " B"],
) -> Report:
    names = np.array(body.names)
    summed = base.independent[(np.abs(base.K) > 1e-9).any(axis=1)]
    vague = int((half > np.abs(beta)).sum())
    warnings = []
    if vague:
        warnings.append(
            f"{vague} of {len(beta)} base parameters may be 0, by their intervals; faster and "
            "longer motions of all joints would tell them better."
        )
    return Report(
        converged=True,
        iterations=0,
        unidentified=tuple(names[np.sort(np.concatenate([base.dependent, summed]))]),
        warnings=tuple(warnings),
    )


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
