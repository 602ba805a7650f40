"""Rows of a robot's motion, as a linear regression over all joints, and their weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from mcpilco.identification.joint_motion import JointMotion
from mcpilco.identification.moments import Moments
from mcpilco.identification.rigid_body import RigidBody

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
        noisier = None if self.noisier is None else self.noisier[rows]
        reference = None if self.reference is None else self.reference[rows]
        simulate = self.simulate and _then(self.simulate, lambda Y: Y[rows])
        return Rows(self.Y[rows], self.tau[rows], noisier, reference, simulate)

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
            self.simulate and _then(self.simulate, lambda Y: Y / by),
        )


def _then(simulate: Simulate, change: Callable[[np.ndarray], np.ndarray]) -> Simulate:
    return lambda theta: change(simulate(theta))


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
