"""Equations of motion of an open chain, for numbers of any kind: floats, or those of a tape.

The same as `mcpilco.bodies.compiled`, whose loops take no derivative.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from functools import reduce
from operator import mul
from typing import Any, Literal

import numpy as np

from mcpilco.plant.arithmetic import Real, cos, larger, sin, sqrt

Vector = Sequence[Any]
Matrix = Sequence[Sequence[Any]]
ZERO = (0.0, 0.0, 0.0)
LEAST_INERTIA = 0.1
"""part of each pivot of the mass matrix that further inertia leaves [-]"""


def inverse_dynamics(
    chain: Any, q: Sequence[Real], dq: Sequence[Real], ddq: Sequence[Real], gravity: Vector
) -> list[Any]:
    """tau = M(q) q'' + bias(q, q'), body by body in the body's frame [N or N m].

    The chain is one system of `mcpilco.bodies.Chains`, with numbers of any kind; positions are in
    [m or rad], gravity in [m/s^2].

    Reference: Featherstone, Rigid Body Dynamics Algorithms (2008), section 5.3.
    """
    J, cross = len(q), np.cross
    turns: list[np.ndarray] = []
    origins: list[np.ndarray] = []
    # angular velocities and accelerations, accelerations of the frames' origins less gravity
    motions: list[tuple[np.ndarray, ...]] = []
    forces: list[tuple[np.ndarray, np.ndarray]] = []
    for j in range(J):
        p, m = chain.parent[j], chain.mass[j]
        axis, o, c = (_array(x[j]) for x in (chain.axis, chain.origin, chain.center))
        R, I = _array(chain.rotation[j]), _array(chain.inertia[j])  # noqa: E741  the field's letter
        w, b, a = motions[p] if p >= 0 else (_array(ZERO), _array(ZERO), _array(gravity) * -1.0)
        if chain.slides[j]:
            o = o + R @ (axis * q[j])
        else:
            R = R @ _rotation(axis, q[j])
        a = a + cross(b, o) + cross(w, cross(w, o))
        w, b, a = R.T @ w, R.T @ b, R.T @ a
        if chain.slides[j]:
            a = a + axis * ddq[j] + cross(w, axis * dq[j]) * 2.0
        else:
            b = b + axis * ddq[j] + cross(w, axis * dq[j])
            w = w + axis * dq[j]
        force = (a + cross(b, c) + cross(w, cross(w, c))) * m
        turns.append(R)
        origins.append(o)
        motions.append((w, b, a))
        forces.append((force, I @ b + cross(w, I @ w) + cross(c, force)))
    tau: list[Any] = [0.0] * J
    for j in range(J - 1, -1, -1):
        force, moment = forces[j]
        along = force if chain.slides[j] else moment
        tau[j] = _array(chain.axis[j]) @ along + chain.armature[j] * ddq[j]
        p = chain.parent[j]
        if p >= 0:
            force, moment = turns[j] @ force, turns[j] @ moment
            moment = moment + cross(origins[j], force)
            forces[p] = forces[p][0] + force, forces[p][1] + moment
    return tau


def mass_matrix(chain: Any, q: Sequence[Real]) -> list[list[Any]]:
    """M(q) [kg, kg m or kg m^2]: forces that unit accelerations take, without gravity."""
    J = len(q)
    rest = [0.0] * J
    return [
        inverse_dynamics(chain, q, rest, [float(i == j) for i in range(J)], ZERO) for j in range(J)
    ]


def accelerations(
    chain: Any, q: Sequence[Real], dq: Sequence[Real], tau: Sequence[Real]
) -> list[Any]:
    """q'' = M(q)^-1 (tau - bias(q, q')) [m/s^2 or rad/s^2]; arguments as in `inverse_dynamics`."""
    J = len(q)
    L = _cholesky(mass_matrix(chain, q))
    bias = inverse_dynamics(chain, q, dq, [0.0] * J, chain.gravity)
    # L y = tau - bias; L^T x = y
    x: list[Any] = [t - b for t, b in zip(tau, bias, strict=True)]
    for i in range(J):
        x[i] = (x[i] - sum(L[i][k] * x[k] for k in range(i))) / L[i][i]
    for i in range(J - 1, -1, -1):
        x[i] = (x[i] - sum(L[k][i] * x[k] for k in range(i + 1, J))) / L[i][i]
    return x


def accelerations_with(
    chain: Any, q: Sequence[Real], dq: Sequence[Real], tau: Sequence[Real], R: Matrix
) -> list[Any]:
    """q'' = (M(q) + R)^-1 (tau - bias(q, q')) [m/s^2 or rad/s^2].

    Elimination without an exchange of rows. All pivots of a positive definite matrix are positive;
    here each is at least `LEAST_INERTIA` of what it is without R: where R would take more inertia
    than that from a joint, it takes as much.

    Arguments are those of `inverse_dynamics`; R is further inertia, which need not be symmetric.
    """
    J = len(q)
    M = mass_matrix(chain, q)
    L = _cholesky(M)
    bias = inverse_dynamics(chain, q, dq, [0.0] * J, chain.gravity)
    x: list[Any] = [t - b for t, b in zip(tau, bias, strict=True)]
    A = [[a + b for a, b in zip(*rows, strict=True)] for rows in zip(M, R, strict=True)]
    for k in range(J):
        A[k][k] = larger(A[k][k], LEAST_INERTIA * (L[k][k] * L[k][k]))
        for i in range(k + 1, J):
            factor = A[i][k] / A[k][k]
            x[i] = x[i] - factor * x[k]
            A[i][k + 1 :] = [A[i][j] - factor * A[k][j] for j in range(k + 1, J)]
    for k in range(J - 1, -1, -1):
        x[k] = (x[k] - sum(A[k][j] * x[j] for j in range(k + 1, J))) / A[k][k]
    return x


def _cholesky(M: Matrix) -> list[list[Any]]:
    """L, lower triangular, with M = L L^T."""
    J = len(M)
    L: list[list[Any]] = [[0.0] * J for _ in range(J)]
    for i in range(J):
        for j in range(i + 1):
            total = M[j][i] - sum(L[i][k] * L[j][k] for k in range(j))
            L[i][j] = sqrt(total) if i == j else total / L[j][j]
    return L


def _array(numbers: Any) -> Any:
    """Numbers of any kind; one that multiplies them must stand behind them."""
    return np.array(numbers, dtype=object)


def _rotation(axis: np.ndarray, angle: Real) -> np.ndarray:
    """About an axis of length 1: Rodrigues' formula."""
    x, y, z = axis
    outer, skew = _array(np.outer(axis, axis)), _array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    # c (1 - a a^T) + a a^T + s [a x]
    return (np.eye(3) - outer) * cos(angle) + outer + skew * sin(angle)


class PolynomialForces:
    """r(q, q', q'') = R(q) q'' + s(q, q'): the functions of the kernel GIP, with weights.

    Args:
        kinds: of the J joints, `hinge` or `slide` each.
        terms: joint and monomial of each weight; a monomial is the sorted entries that it
            multiplies of z, see `mcpilco.dynamics.features.JointPolynomials`.
        most: largest acceleration of each joint under these forces [m/s^2 or rad/s^2]: where they
            are extrapolated, polynomials have no bounds.

    Reference: thesis eq. (3.8).
    """

    def __init__(
        self,
        kinds: Sequence[Literal["hinge", "slide"]],
        terms: Sequence[tuple[int, tuple[int, ...]]],
        most: Sequence[float],
    ) -> None:
        self.hinges = [j for j, kind in enumerate(kinds) if kind == "hinge"]
        self.slides = [j for j, kind in enumerate(kinds) if kind == "slide"]
        self.terms = tuple(terms)
        self.most = tuple(most)

    @property
    def count(self) -> int:
        """How many weights there are."""
        return len(self.terms)

    def __call__(
        self, q: Sequence[Real], v: Sequence[Real], weights: Sequence[Real]
    ) -> tuple[list[list[Any]], list[Any]]:
        """R [kg, kg m or kg m^2] and s [N or N m]."""
        J = len(q)
        places = [*(cos(q[j]) for j in self.hinges), *(sin(q[j]) for j in self.hinges)]
        places += [q[j] for j in self.slides]
        products = [v[i] * v[j] for i in range(J) for j in range(i, J)]
        first = len(places)
        # what a joint's force has of 1, each product of velocities and each acceleration
        shares: dict[tuple[int, int], Any] = defaultdict(float)
        for (joint, monomial), weight in zip(self.terms, weights, strict=True):
            at = [places[d] for d in monomial if d < first]
            moved = max(monomial, default=-1) - first  # -1 and below: it is of the position alone
            share = weight * reduce(mul, at) if at else weight
            shares[joint, max(moved, -1)] = share + shares[joint, max(moved, -1)]
        R: list[list[Any]] = [[0.0] * J for _ in range(J)]
        s: list[Any] = [0.0] * J
        for (joint, moved), share in shares.items():
            if moved >= len(products):
                R[joint][moved - len(products)] = share
            else:
                s[joint] = s[joint] + (share * products[moved] if moved >= 0 else share)
        return R, s
