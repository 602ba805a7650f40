"""The seed's virtual parameters: any of them are parameters with positive mass and inertia.

They are necessary for a body that can exist, and not sufficient: the triangle inequality of the
principal moments is not among them. `mcpilco.identification.projection` is sufficient.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Inexact
from scipy.optimize import least_squares

from mcpilco.identification.consistency import inertia_of
from mcpilco.identification.rigid_body import TERMS, RigidBody
from mcpilco.mechanics import INERTIAL

_ROWS, _COLUMNS = np.triu_indices(3)
_LEAST = 1e-3  # of an estimate's size: what starts from less would not move


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
) -> Float[np.ndarray, " D"]:
    """The parameters of the form of eq. (5) near an estimate, in the metric.

    Friction is the square of a virtual parameter too. The problem is not convex: what comes back
    is a local minimum near the estimate.

    Args:
        body: what the parameters belong to.
        estimate: theta_B.
        metric: H, positive semidefinite, as for `project`.

    Reference: Ting et al., section III-B, eqs. (5) and (8).
    """
    links, positive = len(body.chain.bodies), _positive(body)
    values, vectors = np.linalg.eigh(metric)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    root /= max(np.linalg.norm(root @ estimate), 1e-300)

    def theta_of(virtual: np.ndarray) -> np.ndarray:
        blocks = virtual.reshape(links, body.width)
        terms = blocks[:, len(INERTIAL) :]
        terms = np.where(positive, terms**2, terms)
        return np.concatenate([from_virtual(blocks[:, : len(INERTIAL)]), terms], axis=1).ravel()

    blocks = estimate.reshape(links, body.width)
    terms = blocks[:, len(INERTIAL) :]
    least = _LEAST * np.abs(terms).max(axis=0, initial=0.0)
    terms = np.where(positive, np.sqrt(np.maximum(terms, least)), terms)
    start = np.concatenate([to_virtual(blocks[:, : len(INERTIAL)]), terms], axis=1).ravel()
    found = least_squares(
        lambda virtual: root @ (theta_of(virtual) - estimate), start, jac="cs", x_scale="jac"
    )
    return theta_of(found.x)


def _positive(body: RigidBody) -> np.ndarray:
    return np.array([TERMS[term].positive for term in body.terms], dtype=bool)
