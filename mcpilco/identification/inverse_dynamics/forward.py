"""Forward dynamics through a model of the inverse: M(q) q'' = tau - n(q, q')."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.identification.inverse_dynamics.model import InverseDynamics
from mcpilco.typing import NotPositiveDefiniteError

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

    Args:
        model: of the inverse dynamics.
        q: positions [rad or m].
        unit: acceleration that the columns are found with [rad/s^2 or m/s^2].
    """
    J = q.shape[-1]
    still = torch.zeros_like(q)
    pushes = unit * torch.cat([torch.zeros(1, J), torch.eye(J)]).to(q)  # J+1 J
    shape = (*q.shape[:-1], J + 1, J)
    parts = [q[..., None, :].expand(shape), still[..., None, :].expand(shape), pushes.expand(shape)]
    tau = model(torch.cat(parts, -1))
    M = (tau[..., 1:, :] - tau[..., :1, :]).mT / unit
    asymmetry = (M - M.mT).abs().amax((-2, -1)) / M.abs().amax((-2, -1))
    # of M_ij and M_ji the one that the joint with the smaller torques tells has the smaller error
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

    Args:
        model: of the inverse dynamics.
        q: positions [rad or m].
        dq: velocities [rad/s or m/s].
        tau: torques [N m or N].
        indefinite: what to do where M is not positive definite, so that a push may accelerate the
            robot against itself: `raise`, or answer NaN there, for a rollout that leaves these
            particles out.
        unit: see `inertia`.

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
