"""The seed's virtual parameters: any of them are parameters with positive mass and inertia.

They are necessary for a body that can exist, and not sufficient: the triangle inequality of the
principal moments is not among them. `mcpilco.identification.projection` is sufficient.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Inexact
from scipy.optimize import least_squares

from mcpilco.bodies import INERTIAL
from mcpilco.identification.consistency import (
    check,
    from_pseudo_inertia,
    inertia_of,
    pseudo_inertia,
)
from mcpilco.identification.projection import Projection, cost_of
from mcpilco.identification.rigid_body import TERMS, RigidBody

_ROWS, _COLUMNS = np.triu_indices(3)
_LEAST = 1e-3  # of an estimate's size: what starts from less would not move
_RAISED = 1e-2  # of a link's largest eigenvalue: smaller ones of J start from this
_EVALUATIONS = 150  # of the search; it creeps where a link has next to no mass
_STEP = 1e-30  # complex, so that it cancels nothing


def from_virtual(virtual: Inexact[np.ndarray, "K 10"]) -> Inexact[np.ndarray, "K 10"]:
    """theta of virtual parameters: root of the mass, center of mass, triangular factor of I_c.

        m = v1^2,  h = m c,  c = (v2, v3, v4),  I = U^T U + m (c^T c 1 - c c^T),

            [ v5 v6 v7  ]
        U = [    v8 v9  ]
            [       v10 ]

    Reference: Ting et al., eq. (5), in matrices.
    """
    m, c = virtual[:, 0] ** 2, virtual[:, 1:4]
    U = np.zeros((len(virtual), 3, 3), dtype=virtual.dtype)
    U[:, _ROWS, _COLUMNS] = virtual[:, 4:]
    square = (c * c).sum(1)[:, None, None] * np.eye(3)
    inertia = U.transpose(0, 2, 1) @ U + m[:, None, None] * (square - c[:, :, None] * c[:, None])
    six = inertia[:, _ROWS, _COLUMNS]
    return np.concatenate([m[:, None], m[:, None] * c, six], axis=1)


def to_virtual(theta: Float[np.ndarray, "K 10"]) -> Float[np.ndarray, "K 10"]:
    """Virtual parameters near theta: of its mass and inertia, made positive where they are not."""
    m = np.maximum(theta[:, 0], _LEAST * np.abs(theta[:, 0]).max() + 1e-12)
    c = theta[:, 1:4] / m[:, None]
    square = (c * c).sum(1)[:, None, None] * np.eye(3)
    about = inertia_of(theta) - m[:, None, None] * (square - c[:, :, None] * c[:, None])
    values, vectors = np.linalg.eigh(about)
    values = np.maximum(values, _LEAST * np.abs(values).max(axis=1, keepdims=True) + 1e-12)
    positive = np.einsum("kij,kj,klj->kil", vectors, values, vectors)
    U = np.linalg.cholesky(positive).transpose(0, 2, 1)
    return np.concatenate([np.sqrt(m)[:, None], c, U[:, _ROWS, _COLUMNS]], axis=1)


def project_virtual(
    body: RigidBody,
    estimate: Float[np.ndarray, " D"],
    metric: Float[np.ndarray, "D D"],
) -> Projection:
    """The parameters of the form of eq. (5) near an estimate, in the metric.

    Friction is the square of a virtual parameter too. The problem is not convex: what comes back
    is a local minimum near the estimate, without a bound on its gap.

    Args:
        body: what the parameters belong to.
        estimate: theta_B.
        metric: H, positive semidefinite, as for `project`.

    Reference: Ting et al., section III-B, eqs. (5) and (8).
    """
    positive = _positive(body)
    values, vectors = np.linalg.eigh(metric)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    root /= max(np.linalg.norm(root @ estimate), 1e-300)
    found = least_squares(
        lambda virtual: root @ (_theta(virtual.reshape(-1, body.width), positive) - estimate),
        _start(body, estimate).ravel(),
        jac=lambda virtual: _slope(virtual.reshape(-1, body.width), positive, root),
        x_scale="jac",
        max_nfev=_EVALUATIONS,
    )
    theta = _theta(found.x.reshape(-1, body.width), positive)
    return Projection(
        theta=theta,
        cost=cost_of(theta, estimate, metric),
        gap=float("inf"),
        before=check(body, estimate),
        steps=int(found.nfev),
        converged=found.status > 0,
    )


def _theta(
    virtual: Inexact[np.ndarray, "K W"], positive: Bool[np.ndarray, " F"]
) -> Inexact[np.ndarray, " D"]:
    """The parameters of all links, friction too."""
    terms = virtual[:, len(INERTIAL) :]
    terms = np.where(positive, terms**2, terms)
    return np.concatenate([from_virtual(virtual[:, : len(INERTIAL)]), terms], axis=1).ravel()


def _slope(
    virtual: Float[np.ndarray, "K W"],
    positive: Bool[np.ndarray, " F"],
    root: Float[np.ndarray, "D D"],
) -> Float[np.ndarray, "D D"]:
    """Derivative of root theta: of all links at once, for none depends on another's numbers."""
    rows = root.reshape(-1, *virtual.shape)
    slope = np.empty_like(rows)
    for column in range(virtual.shape[1]):
        moved = virtual.astype(complex)
        moved[:, column] += 1j * _STEP
        change = _theta(moved, positive).imag.reshape(virtual.shape) / _STEP
        slope[:, :, column] = np.einsum("dkw,kw->dk", rows, change)
    return slope.reshape(root.shape)


def _start(body: RigidBody, estimate: Float[np.ndarray, " D"]) -> Float[np.ndarray, "K W"]:
    """Virtual parameters of bodies near the estimate: its pseudo-inertias, made positive.

    A link whose mass is next to 0 would have its center of mass far away, and a search from there
    comes nowhere.
    """
    blocks = estimate.reshape(-1, body.width)
    theta, terms = blocks[:, : len(INERTIAL)], blocks[:, len(INERTIAL) :]
    if not _has_virtual(theta):
        values, vectors = np.linalg.eigh(pseudo_inertia(theta))
        least = _RAISED * np.maximum(values[:, -1:], _RAISED * values[:, -1].max() + 1e-12)
        raised = np.maximum(values, least)
        theta = from_pseudo_inertia(np.einsum("kij,kj,klj->kil", vectors, raised, vectors))
    least = _LEAST * np.abs(terms).max(axis=0, initial=0.0)
    terms = np.where(_positive(body), np.sqrt(np.maximum(terms, least)), terms)
    return np.concatenate([to_virtual(theta), terms], axis=1)


def _has_virtual(theta: Float[np.ndarray, "K 10"]) -> bool:
    """Whether all are of the form of eq. (5) already."""
    m, h = theta[:, :1], theta[:, 1:4]
    if (m <= 0.0).any():
        return False
    square = (h * h).sum(1)[:, None, None] * np.eye(3)
    about = inertia_of(theta) - (square - h[:, :, None] * h[:, None]) / m[:, :, None]
    return bool((np.linalg.eigvalsh(about)[:, 0] >= 0.0).all())


def _positive(body: RigidBody) -> Bool[np.ndarray, " F"]:
    return np.array([TERMS[term].positive for term in body.terms], dtype=bool)
