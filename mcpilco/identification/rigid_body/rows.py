"""Rows of a linear regression over all joints of a robot, and their weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from mcpilco.identification.noisy_inputs import Moments
from mcpilco.identification.rigid_body.body import RigidBody
from mcpilco.identification.rigid_body.projection import project
from mcpilco.identification.rigid_body.robot_model import (
    Feedback,
    follow_reference,
    with_parameters,
)
from mcpilco.recordings import JointMotion, Segment, encoder_noise, local_cubics, zero_phase
from mcpilco.typing import InputError

REFITS = 4
"""of the weights"""

Simulate = Callable[[np.ndarray], np.ndarray]
"""from parameters (D,), consistent or not, to the regressor (N, J, D) of a simulated motion"""


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
    simulate: Simulate | None = None
    """regressors of simulated motions, without noise; for IDIM-IV"""

    def __len__(self) -> int:
        return len(self.Y)

    def __getitem__(self, rows: slice | np.ndarray) -> Rows:
        return self._changed(lambda Y: Y[rows], self.tau[rows])

    def _changed(self, change: Callable[[np.ndarray], np.ndarray], tau: np.ndarray) -> Rows:
        """With other forces, and all regressors changed alike."""
        regressors = {name: getattr(self, name) for name in ("Y", "noisier", "reference")}
        changed: dict[str, Any] = {
            name: change(Y) for name, Y in regressors.items() if Y is not None
        }
        if (simulate := self.simulate) is not None:
            changed["simulate"] = lambda theta: change(simulate(theta))
        return replace(self, tau=tau, **changed)

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

        The encoders' `noise` and the commanded `reference` have gone through the motion's filter.
        """
        noisier = None
        if noise is not None:
            more = replace(
                motion, q=motion.q + noise.q, dq=motion.dq + noise.dq, ddq=motion.ddq + noise.ddq
            )
            noisier = body.regressor_of(more)
        commanded = None if reference is None else body.regressor_of(reference)
        return cls(body.regressor_of(motion), motion.tau, noisier, commanded)

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """All rows of several stretches; what one of them lacks, none has."""

        def all_of(name: str) -> np.ndarray | None:
            arrays = [getattr(part, name) for part in parts]
            return None if any(array is None for array in arrays) else np.concatenate(arrays)

        def simulate(theta: np.ndarray) -> np.ndarray:
            return np.concatenate([part.simulate(theta) for part in parts if part.simulate])

        arrays: dict[str, Any] = {
            name: all_of(name) for name in ("Y", "tau", "noisier", "reference")
        }
        simulated = all(part.simulate for part in parts)
        return replace(parts[0], simulate=simulate if simulated else None, **arrays)

    def scaled(self, scale: Float[np.ndarray, " J"]) -> Rows:
        """All divided by a number a joint."""
        return self._changed(lambda Y: Y / scale[:, None], self.tau / scale)


def force_errors(rows: Rows) -> Float[np.ndarray, " J"]:
    """Root mean square of what least squares leaves of each joint's force [N m or N].

    Found with rows divided by these errors themselves, so that a joint of small forces is fitted
    as closely, relative to its noise, as one of large forces.

    Reference: Gautier, Poignet, Extended Kalman filtering and weighted least squares dynamic
        identification of robot, Control Engineering Practice 9 (12), 2001.
    """
    least = 1e-9 * np.sqrt((rows.tau**2).mean(axis=0)) + 1e-300
    driven = rows.tau.any(axis=0)

    def shared(scale: np.ndarray) -> np.ndarray:
        """Of a joint without a motor, which b = 0 explains, the scale of the others."""
        return np.where(driven, scale, scale[driven].max(initial=1e-300))

    scale = shared(np.maximum(rows.tau.std(axis=0), least))
    for _ in range(REFITS):
        b = Moments.of(rows.Y / scale[:, None], rows.tau / scale).least_squares()
        left = np.sqrt(((rows.tau - rows.Y @ b) ** 2).mean(axis=0))
        scale = shared(np.maximum(left, least))
    return scale


def rows_of_segment(
    body: RigidBody,
    whole: RigidBody,
    segment: Segment,
    filter: str,
    cutoff: float,
    simulated: mujoco.MjModel | None,
) -> tuple[JointMotion, Rows]:
    """A stretch's motion, and its rows without the forces that the model is right about.

    `whole` is the same robot with all terms that there are, `simulated` the model whose simulations
    of the stretch the rows shall have, if any.
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
    measured = np.isfinite(segment.dq).any(axis=0)  # a velocity's noise is not that of a derivative
    commanded = None
    if segment.reference is not None:
        commanded = filtered(segment.reference, unknown, nothing)
    rows = Rows.of(
        body, motion, filtered(noise, np.where(measured, 0.0, np.nan) + nothing, nothing), commanded
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
    return (
        whole.regressor_of(motion) @ values.ravel() if values.any() else np.zeros_like(motion.tau)
    )


def simulated_regressor(
    model: mujoco.MjModel,
    body: RigidBody,
    segment: Segment,
    rows: Rows,
    feedback: Feedback,
    filtered: Callable[[np.ndarray], JointMotion],
) -> Simulate:
    """The regressor of the motion that a robot with given parameters would have made.

    The parameters are projected on consistent ones first; `filtered` makes a motion of positions,
    as that of the rows was made.
    """
    assert segment.reference is not None
    reference, dt = segment.reference, segment.dt
    size = np.maximum(np.sqrt((rows.tau**2).mean(axis=0)), 1e-300)
    metric = rows.scaled(size).metric

    def simulate(theta: np.ndarray) -> np.ndarray:
        robot = with_parameters(model, body, project(body, theta, metric).theta)
        motion = filtered(follow_reference(robot, reference, dt, feedback))
        return body.regressor_of(motion)

    return simulate
