"""Rows of a regression from a stretch of a robot's log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from jaxtyping import Float

from mcpilco.identification.closed_loop import Feedback, simulated_regressor
from mcpilco.identification.joint_motion import (
    JointMotion,
    encoder_noise,
    local_cubics,
    zero_phase,
)
from mcpilco.identification.rigid_body import RigidBody
from mcpilco.identification.rows import Rows
from mcpilco.recordings import Segment
from mcpilco.typing import InputError


def rows_of_segment(
    body: RigidBody,
    whole: RigidBody,
    segment: Segment,
    filter: str,
    cutoff: float,
    simulated: mujoco.MjModel | None,
) -> tuple[JointMotion, Rows]:
    """A stretch's motion, and its rows without the forces that the model is right about.

    Args:
        body: whose parameters are to be found.
        whole: the same robot with all terms that there are.
        segment: the stretch.
        filter: zero-phase or local-cubics.
        cutoff: of the zero-phase filter [Hz].
        simulated: model whose simulations of the stretch the rows shall have, if any.

    Raises:
        InputError: the stretch is too short, or shows no feedback that could be simulated.
    """
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
    rows = replace(rows, tau=motion.tau - _left_out(body, whole, motion))
    if simulated is None or commanded is None:
        return motion, rows
    feedback = Feedback.of(motion, commanded, body.chain.joints)
    simulate = simulated_regressor(
        simulated, body, segment, rows, feedback, lambda q: filtered(q, unknown, nothing)
    )
    return motion, replace(rows, simulate=simulate)


def _left_out(body: RigidBody, whole: RigidBody, motion: JointMotion) -> Float[np.ndarray, "N J"]:
    """Forces of the terms that are not to be found, with the model's values."""
    kept = [name in body.terms for name in whole.terms]
    values = whole.nominal.reshape(-1, whole.width).copy()
    values[:, : -len(kept)] = 0.0
    values[:, -len(kept) :][:, kept] = 0.0
    return motion.regressor(whole) @ values.ravel() if values.any() else np.zeros_like(motion.tau)


def joined(parts: Sequence[Rows]) -> Rows:
    """All rows of several stretches; what one of them lacks, none has."""

    def all_of(name: str) -> np.ndarray | None:
        arrays = [getattr(part, name) for part in parts]
        return None if any(array is None for array in arrays) else np.concatenate(arrays)

    def simulate(theta: np.ndarray) -> np.ndarray:
        return np.concatenate([part.simulate(theta) for part in parts if part.simulate])

    Y, tau = (np.concatenate([getattr(part, name) for part in parts]) for name in ("Y", "tau"))
    told = all(part.simulate for part in parts)
    return Rows(Y, tau, all_of("noisier"), all_of("reference"), simulate if told else None)
