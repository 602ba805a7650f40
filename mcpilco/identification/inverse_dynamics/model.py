"""Models of a robot's inverse dynamics, and their use: forward dynamics and feed-forward control.

A motion [q, q', q''] of J joints has a width of Q = 3 J.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.identification.report import Report
from mcpilco.recordings import JointData
from mcpilco.typing import InputError, NotPositiveDefiniteError

Planned = Float[np.ndarray, "T J"]
"""a motion's numbers for each joint"""
PerJoint = Float[np.ndarray, "*#b J"]
"""a number for each joint"""


@dataclass(frozen=True)
class Fitted:
    """The fit that a model comes from, as its file keeps it."""

    kernel: str
    """by which name it is built, a key of `ESTIMATORS`"""
    joints: tuple[str, ...]
    """names, in the order of q"""
    torque_std: tuple[float, ...]
    """standard deviation of each joint's torque in the data [N m or N]"""
    report: Report
    """how it went"""
    built: Mapping[str, Any] = field(default_factory=dict)
    """what else a file must say to build the model anew"""

    @classmethod
    def to(cls, kernel: str, data: JointData, report: Report, **built: Any) -> Fitted:
        """A model that was fitted to data."""
        as_read = json.loads(json.dumps(built))  # equal before and after a file
        return cls(kernel, data.joints, tuple(data.tau.std(0).tolist()), report, as_read)


class InverseDynamics(ABC):
    """The torques that a motion takes, learned from data: tau(q, q', q'')."""

    def __init__(self, fitted: Fitted) -> None:
        self.fitted = fitted

    @property
    def joints(self) -> tuple[str, ...]:
        """Names, in the order of q."""
        return self.fitted.joints

    @property
    def report(self) -> Report:
        """How the fit went."""
        return self.fitted.report

    @abstractmethod
    def __call__(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J"]:
        """Torques of motions [q, q', q''] of any batch shape, differentiable by the motion.

        Positions, velocities and accelerations stand side by side [rad or m, by s].
        """

    @abstractmethod
    def to_groups(self) -> dict[str, dict[str, np.ndarray]]:
        """Everything learned, as named arrays: what `load_inverse_dynamics` reads."""

    def std(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J"] | None:
        """Standard deviation of the torques, without the noise; None of models without one."""
        return None

    def nmse(self, data: JointData) -> Float[np.ndarray, " J"]:
        """Mean squared error of each joint, in parts of the variance of its torque [-].

        Raises:
            InputError: a torque does not vary in these data.

        Reference: thesis section 3.4.1.
        """
        for joint, variance in zip(data.joints, data.tau.var(0), strict=True):
            if not variance > 0.0:
                raise InputError(
                    f"the torque of joint {joint!r} is constant in the test data, so its error has "
                    "no scale; test on a motion that moves every joint."
                )
        with torch.no_grad():
            errors = self(data.motion).numpy() - data.tau
        return np.mean(errors**2, 0) / np.var(data.tau, 0)


UNIT = 1.0
"""acceleration by which the columns of M are found [rad/s^2 or m/s^2]"""


@dataclass(frozen=True, eq=False)
class Inertia:
    """The inertia matrices that a model has at some positions."""

    matrix: Float[Tensor, "*b J J"]
    """M, symmetrised: of two entries the one with the smaller torques counts more [kg m^2 or kg]"""
    asymmetry: Float[Tensor, "*b"]
    """largest |M - M^T| before that, in parts of the largest |M| [-]: 0 for a rigid body"""
    positive: Bool[Tensor, "*b"]
    """whether M is positive definite, as that of every robot is"""


def inertia(model: InverseDynamics, q: Float[Tensor, "*b J"], unit: float = UNIT) -> Inertia:
    """M(q), column by column: M e_j = tau(q, 0, e_j) - tau(q, 0, 0).

    Torques are affine in the accelerations for the kernels `gip` and `pp` and for `fe`, and the
    columns exact. `rbf`, `sp` and `nn` are not, and see a slope over `unit`.

    The columns are found with the acceleration `unit` [rad/s^2 or m/s^2].
    """
    J = q.shape[-1]
    still = torch.zeros_like(q)
    units = unit * torch.cat([torch.zeros(1, J), torch.eye(J)]).to(q)  # J+1 J
    shape = (*q.shape[:-1], J + 1, J)
    parts = [q[..., None, :].expand(shape), still[..., None, :].expand(shape), units.expand(shape)]
    tau = model(torch.cat(parts, -1))
    M = (tau[..., 1:, :] - tau[..., :1, :]).mT / unit
    asymmetry = (M - M.mT).abs().amax((-2, -1)) / M.abs().amax((-2, -1))
    # of M_ij and M_ji the one of the joint with the smaller torques has the smaller error
    trust = torch.tensor(model.fitted.torque_std).to(q).pow(-2)
    share = trust[:, None] / (trust[:, None] + trust)
    M = share * M + share.mT * M.mT
    return Inertia(M, asymmetry.detach(), torch.linalg.cholesky_ex(M.detach())[1] == 0)


def accelerations(
    model: InverseDynamics,
    q: Float[Tensor, "*b J"],
    dq: Float[Tensor, "*b J"],
    tau: Float[Tensor, "*b J"],
    *,
    indefinite: Literal["raise", "nan"] = "raise",
    unit: float = UNIT,
) -> Float[Tensor, "*b J"]:
    """q'' = M(q)^-1 (tau - n(q, q')) [rad/s^2 or m/s^2], differentiable by all three.

    n(q, q') = tau(q, q', 0) are the forces of gravity, of velocities and of friction.

    Where M is not positive definite, so that a push may accelerate the robot against itself,
    `indefinite` raises, or answers NaN for a rollout that leaves these particles out.

    Raises:
        NotPositiveDefiniteError: M is not positive definite somewhere.

    Reference: Featherstone, Rigid Body Dynamics Algorithms (2008), section 6.1.
    """
    M = inertia(model, q, unit)
    if indefinite == "raise" and not bool(M.positive.all()):
        raise NotPositiveDefiniteError(_complaint(model, q, M))
    n = model(torch.cat([q, dq, torch.zeros_like(q)], -1))
    one = torch.eye(q.shape[-1], dtype=q.dtype)
    L, _ = torch.linalg.cholesky_ex(torch.where(M.positive[..., None, None], M.matrix, one))
    ddq = torch.cholesky_solve((tau - n)[..., None], L).squeeze(-1)
    return torch.where(M.positive[..., None], ddq, torch.nan)


def _complaint(model: InverseDynamics, q: Tensor, M: Inertia) -> str:
    bad = ~M.positive
    where = ", ".join(
        f"{joint} = {value:.3g}"
        for joint, value in zip(model.joints, q[bad][0].tolist(), strict=True)
    )
    return (
        f"The learned inertia matrix is not positive definite at {int(bad.sum())} of {bad.numel()} "
        f"positions, the first of them {where}; record more motions near there, stay within the "
        'positions of the data, or ask for indefinite="nan".'
    )


@dataclass(frozen=True, eq=False)
class FeedForward:
    """tau = model(q_d, q'_d, q''_d) + K_p (q_d - q) + K_d (q'_d - q').

    The model gives what the planned motion takes, the feedback mends what it gets wrong. Without a
    model it is a PD controller.

    Reference: Siciliano et al., Robotics: Modelling, Planning and Control (2009), section 8.5.
    """

    model: InverseDynamics | None
    """None: feedback alone"""
    proportional: Float[np.ndarray, " J"]
    """K_p [N m/rad or N/m]"""
    derivative: Float[np.ndarray, " J"]
    """K_d [N m s/rad or N s/m]"""

    def __post_init__(self) -> None:
        for name in ("proportional", "derivative"):
            gains = np.asarray(getattr(self, name))
            if gains.ndim != 1 or not (np.isfinite(gains) & (gains >= 0)).all():
                raise InputError(
                    f"FeedForward.{name} must be a gain >= 0 for each joint, got {gains.tolist()}."
                )

    def plan(self, q: Planned, dq: Planned, ddq: Planned) -> Planned:
        """Torques of a planned motion [N m or N]: once, before it begins."""
        if self.model is None:
            return np.zeros_like(q)
        with torch.no_grad():
            motion = torch.as_tensor(np.concatenate([q, dq, ddq], -1), dtype=torch.float64)
            return self.model(motion).numpy()

    def torque(self, planned: PerJoint, q_error: PerJoint, dq_error: PerJoint) -> PerJoint:
        """Torques to command [N m or N].

        Of a row of `plan`, and of the errors q_d - q [rad or m] and q'_d - q' [rad/s or m/s].
        """
        return planned + self.proportional * q_error + self.derivative * dq_error
