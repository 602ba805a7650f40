"""The physically consistent parameters nearest to an estimate.

    minimise  1/2 (theta - theta_B)^T H (theta - theta_B)    where all J_k(theta) >= 0

and all friction >= 0: a convex problem (a semidefinite program). H = X^T X is the seed's metric,
eq. (8), in which the distance is the increase of the squared error of the forces.

`Differs:` from eq. (8), which adds the variance of the input noise to X^T X: the noise is already
in the measured X. From eq. (7): its second term is 0 at the least-squares estimate only; for other
estimates theta_B the projection is the nearest consistent point, and not the consistent point of
least squared error. Pass the least-squares estimate to get that one.

`project_virtual` is the projection of Ting et al., on parameters with positive mass and inertia.
These are necessary for a body that can exist, and not sufficient: the triangle inequality of the
principal moments is not among them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Inexact
from scipy.linalg import block_diag, cho_factor, cho_solve
from scipy.optimize import least_squares

from mcpilco.bodies import INERTIAL
from mcpilco.identification.rigid_body.body import (
    TERMS,
    LinkCheck,
    RigidBody,
    check_links,
    from_pseudo_inertia,
    inertia_of,
    pseudo_inertia,
)
from mcpilco.typing import InputError, NotPositiveDefiniteError

Theta = Float[np.ndarray, " D"]
"""parameters of a robot, in the units of `RigidBody.units`"""
Metric = Float[np.ndarray, "D D"]
"""of such parameters"""

GAP = 1e-5
"""how far the cost may be above the optimum, relative to it"""
UNSEEN = 1e-10
"""weight of what H does not see, relative to what it sees best"""
_LEAST = 1e-13  # cost relative to that of theta_B = 0 at which accuracy ends
_SHRINK = 0.2  # of the barrier's weight, a round
_NEWTON_STEPS = 50  # a round; 5 to 10 are usual
_CENTERED = 1e-3  # squared Newton decrement at which a round ends
_ROUNDS = 80


@dataclass(frozen=True)
class Projection:
    """The nearest consistent parameters."""

    theta: Float[np.ndarray, " D"]
    """in the units of the estimate"""
    cost: float
    """1/2 (theta - theta_B)^T H (theta - theta_B)"""
    gap: float
    """bound on how far the cost is above the optimum; infinite where there is none"""
    before: tuple[LinkCheck, ...]
    """consistency of the estimate, link by link"""
    steps: int
    """of the search; 0 where the estimate was consistent, and comes back unchanged"""
    converged: bool
    """whether the search stopped by its own tolerance"""

    @classmethod
    def none(cls, body: RigidBody, estimate: Theta) -> Projection:
        """The estimate as it is, consistent or not."""
        return cls(estimate.copy(), 0.0, 0.0, check_links(body, estimate), 0, True)


def project(body: RigidBody, estimate: Theta, metric: Metric, gap: float = GAP) -> Projection:
    """The consistent parameters nearest to an estimate; a consistent estimate comes back unchanged.

    Directions that the metric does not see (parameters that no force depends on) are filled in by
    the smallest change of the estimate.

    The metric H is positive semidefinite: X^T X of the rows that the estimate theta_B was fitted
    to, or the inverse of its covariance. The cost is found as accurately as `gap`, relative to it.

    Raises:
        InputError: the metric has a negative eigenvalue, or something is not finite.
        NotPositiveDefiniteError: rounding stopped the search; scale the metric.
    """
    if not (np.isfinite(estimate).all() and np.isfinite(metric).all()):
        raise InputError("estimate and metric must be finite; leave out what was not estimated.")
    values = np.linalg.eigvalsh(metric)
    if values[0] < -1e-8 * max(values[-1], 1e-300) or values[-1] <= 0.0:
        raise InputError(
            f"metric must be positive semidefinite and not 0, got eigenvalues from {values[0]:.3g} "
            f"to {values[-1]:.3g}; give X^T X."
        )
    unchanged = Projection.none(body, estimate)
    if all(link.consistent for link in unchanged.before):
        return unchanged
    scale = _scales(body, estimate)
    seen = scale[:, None] * metric * scale
    size = np.linalg.eigvalsh(seen)[-1]
    H = seen / size + UNSEEN * np.eye(len(seen))
    cone = _Cone(body, scale)
    point, bound, steps, converged = _minimise(cone, H, estimate / scale, gap)
    theta = point * scale
    cost = cost_of(theta, estimate, metric)
    return Projection(theta, cost, bound * size, unchanged.before, steps, converged)


def cost_of(theta: Theta, estimate: Theta, metric: Metric) -> float:
    """1/2 (theta - theta_B)^T H (theta - theta_B)."""
    away = theta - estimate
    return 0.5 * float(away @ metric @ away)


def _scales(body: RigidBody, estimate: Theta) -> Theta:
    """A size for each parameter: of a mass M, a length L, and friction by its own kind."""
    blocks = np.abs(estimate.reshape(-1, body.width))
    M = blocks[:, 0].max() or 1.0
    L = np.sqrt(blocks[:, [4, 7, 9]].max() / M) or 1.0
    terms = blocks[:, len(INERTIAL) :].max(axis=0)
    powers = np.array([M, *[M * L] * 3, *[M * L**2] * 6])
    each = np.concatenate([powers, np.where(terms > 0.0, terms, 1.0)])
    return np.tile(each, len(blocks))


class _Cone:
    """Where J and friction are positive, with the coordinates of the barrier -log det J - log f.

    In coordinates x about a point, J = L (1 + B(x)) L^T and f (1 + x), with L L^T the point's J and
    B an isometry, the barrier's Hessian is the identity.
    """

    def __init__(self, body: RigidBody, scale: Theta) -> None:
        self.links, self.width = len(body.chain.bodies), body.width
        self.positive = np.array([TERMS[term].positive for term in body.terms], dtype=bool)
        basis = []  # of symmetric matrices, orthonormal
        for i, j in zip(*np.triu_indices(4), strict=True):
            E = np.zeros((4, 4))
            E[i, j] = E[j, i] = 1.0 if i == j else np.sqrt(0.5)
            basis.append(E)
        self.basis = np.array(basis)
        self.degree = self.links * (4 + int(self.positive.sum()))
        """nu: the gap at a central point is nu times the barrier's weight"""
        block = np.concatenate([np.ones(len(INERTIAL)), self.positive])
        self.barred: Bool[np.ndarray, " D"] = np.tile(block, self.links).astype(bool)

    def split(self, theta: Theta) -> tuple[Float[np.ndarray, "K 4 4"], Float[np.ndarray, "K F"]]:
        """Pseudo-inertias J and the joints' terms."""
        blocks = theta.reshape(self.links, self.width)
        return pseudo_inertia(blocks[:, : len(INERTIAL)]), blocks[:, len(INERTIAL) :]

    def start(self, theta: Theta) -> Theta:
        """A point within: eigenvalues and friction that are too small are raised."""
        J, terms = self.split(theta)
        values, vectors = np.linalg.eigh(J)
        least = 1e-2 * np.maximum(values[:, -1:], 1e-2)
        J = np.einsum("kij,kj,klj->kil", vectors, np.maximum(values, least), vectors)
        terms = np.where(self.positive, np.maximum(terms, 1e-2), terms)
        return np.concatenate([from_pseudo_inertia(J), terms], axis=1).ravel()

    def frame(self, theta: Theta) -> Metric:
        """T of d theta = T dx."""
        J, terms = self.split(theta)
        L = np.linalg.cholesky(J)
        moved = np.einsum("kij,bjl,kml->kbim", L, self.basis, L)
        inertial = from_pseudo_inertia(moved).transpose(0, 2, 1)
        sizes = np.where(self.positive, terms, 1.0)
        return block_diag(
            *(block_diag(a, np.diag(f)) for a, f in zip(inertial, sizes, strict=True))
        )

    def rates(self, step: Theta) -> Float[np.ndarray, " R"]:
        """e of 1 + a e, the eigenvalues and terms that a step of length a leaves, over the old."""
        blocks = step.reshape(self.links, self.width)
        inertial, terms = blocks[:, : len(INERTIAL)], blocks[:, len(INERTIAL) :]
        values = np.linalg.eigvalsh(np.einsum("kb,bij->kij", inertial, self.basis))
        return np.concatenate([values.ravel(), terms[:, self.positive].ravel()])

    def trace(self) -> Theta:
        """The gradient of log det J + log f, the same at every point."""
        traces = np.concatenate([np.trace(self.basis, axis1=1, axis2=2), self.positive])
        return np.tile(traces, self.links)


def _minimise(cone: _Cone, H: Metric, target: Theta, gap: float) -> tuple[Theta, float, int, bool]:
    """The nearest point, by a path of central points.

    With a bound on its excess cost, Newton steps, and whether the bound is as small as asked for.

    Reference: Boyd, Vandenberghe, Convex optimization, 2004, section 11.3.
    """
    theta = cone.start(target)
    floor = _LEAST * max(1.0, 0.5 * float(target @ H @ target))
    weight, steps = max(cost_of(theta, target, H), floor) / cone.degree, 0
    for _ in range(_ROUNDS):
        theta, taken, central = _center(cone, H, target, theta, weight)
        steps += taken
        # a central point's gap is nu weight; one that is nearly central has at most twice that
        bound = 2.0 * cone.degree * weight
        if bound <= max(gap * cost_of(theta, target, H), floor):
            return theta, bound, steps, central
        weight *= _SHRINK
    return theta, bound, steps, False


def _center(
    cone: _Cone, H: Metric, target: Theta, theta: Theta, weight: float
) -> tuple[Theta, int, bool]:
    """Newton's method on cost / weight + barrier, in coordinates in which no step is steep.

    The point, steps, and whether it is central.
    """
    taken, decrement = 0, np.inf
    while decrement > _CENTERED and taken < _NEWTON_STEPS:
        T = cone.frame(theta)
        pull = T.T @ (H @ (theta - target)) / weight
        curvature = T.T @ H @ T / weight
        gradient = pull - cone.trace()
        newton = curvature + np.diag(cone.barred.astype(float))
        try:
            x = -cho_solve(cho_factor(newton), gradient)
        except np.linalg.LinAlgError:
            raise NotPositiveDefiniteError(
                f"the projection's Newton matrix lost its Cholesky factor at barrier weight "
                f"{weight:.3g}; scale the metric, or ask for a larger gap than {GAP:g}."
            ) from None
        decrement = float(-gradient @ x)
        length = _line_search(float(pull @ x), float(x @ curvature @ x), cone.rates(x))
        theta = theta + length * (T @ x)
        taken += 1
    return theta, taken, decrement <= _CENTERED


def _line_search(slope: float, curvature: float, rates: Float[np.ndarray, " R"]) -> float:
    """The a > 0 at which slope a + curvature a^2 / 2 - sum log(1 + rates a) is least.

    By bisection of its derivative, which rises: no step leaves the cone.
    """
    least = float(rates.min())
    low, high = 0.0, 0.99 / -least if least < 0.0 else 10.0
    high = min(high, 10.0)
    for _ in range(30):
        a = 0.5 * (low + high)
        if slope + curvature * a < float((rates / (1.0 + rates * a)).sum()):
            low = a
        else:
            high = a
    return 0.5 * (low + high)


_ROWS, _COLUMNS = np.triu_indices(3)
_RAISED_TO = 1e-3  # of an estimate's size: what starts from less would not move
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
    m = np.maximum(theta[:, 0], _RAISED_TO * np.abs(theta[:, 0]).max() + 1e-12)
    c = theta[:, 1:4] / m[:, None]
    square = (c * c).sum(1)[:, None, None] * np.eye(3)
    about = inertia_of(theta) - m[:, None, None] * (square - c[:, :, None] * c[:, None])
    values, vectors = np.linalg.eigh(about)
    values = np.maximum(values, _RAISED_TO * np.abs(values).max(axis=1, keepdims=True) + 1e-12)
    positive = np.einsum("kij,kj,klj->kil", vectors, values, vectors)
    U = np.linalg.cholesky(positive).transpose(0, 2, 1)
    return np.concatenate([np.sqrt(m)[:, None], c, U[:, _ROWS, _COLUMNS]], axis=1)


def project_virtual(body: RigidBody, estimate: Theta, metric: Metric) -> Projection:
    """The parameters of the form of eq. (5) near an estimate, in the metric.

    Friction is the square of a virtual parameter too. The problem is not convex: what comes back
    is a local minimum near the estimate, without a bound on its gap.

    Arguments are those of `project`.

    Reference: Ting et al., section III-B, eqs. (5) and (8).
    """
    positive = _positive(body)
    values, vectors = np.linalg.eigh(metric)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    root /= max(np.linalg.norm(root @ estimate), 1e-300)
    found = least_squares(
        lambda virtual: root @ (_theta(virtual.reshape(-1, body.width), positive) - estimate),
        _virtual_start(body, estimate).ravel(),
        jac=lambda virtual: _slope(virtual.reshape(-1, body.width), positive, root),
        x_scale="jac",
        max_nfev=_EVALUATIONS,
    )
    theta = _theta(found.x.reshape(-1, body.width), positive)
    return Projection(
        theta=theta,
        cost=cost_of(theta, estimate, metric),
        gap=float("inf"),
        before=check_links(body, estimate),
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
    virtual: Float[np.ndarray, "K W"], positive: Bool[np.ndarray, " F"], root: Metric
) -> Metric:
    """Derivative of root theta: of all links at once, for none depends on another's numbers."""
    rows = root.reshape(-1, *virtual.shape)
    slope = np.empty_like(rows)
    for column in range(virtual.shape[1]):
        moved = virtual.astype(complex)
        moved[:, column] += 1j * _STEP
        change = _theta(moved, positive).imag.reshape(virtual.shape) / _STEP
        slope[:, :, column] = np.einsum("dkw,kw->dk", rows, change)
    return slope.reshape(root.shape)


def _virtual_start(body: RigidBody, estimate: Theta) -> Float[np.ndarray, "K W"]:
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
    least = _RAISED_TO * np.abs(terms).max(axis=0, initial=0.0)
    terms = np.where(_positive(body), np.sqrt(np.maximum(terms, least)), terms)
    return np.concatenate([to_virtual(theta), terms], axis=1)


def _has_virtual(theta: Float[np.ndarray, "K 10"]) -> bool:
    """True where all are of the form of eq. (5) already."""
    m, h = theta[:, :1], theta[:, 1:4]
    if (m <= 0.0).any():
        return False
    square = (h * h).sum(1)[:, None, None] * np.eye(3)
    about = inertia_of(theta) - (square - h[:, :, None] * h[:, None]) / m[:, :, None]
    return bool((np.linalg.eigvalsh(about)[:, 0] >= 0.0).all())


def _positive(body: RigidBody) -> Bool[np.ndarray, " F"]:
    return np.array([TERMS[term].positive for term in body.terms], dtype=bool)
