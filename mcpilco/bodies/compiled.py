"""Equations of motion of an open chain, for compiled callers.

Everything is a spatial vector about the origin of the world and along its axes, so that bodies are
summed without being carried from frame to frame: a motion is (omega, v) with v the velocity of the
body's point that is at the origin, a force is (moment about the origin, force), and a body's
inertia maps the one to the other by its mass m, its first moment h = m c and its inertia I about
the origin:

    moment = I omega + h x v        force = m v - h x omega

Reference: Featherstone, Rigid Body Dynamics Algorithms (2008), chapters 2 (spatial vectors),
    5.3 (recursive Newton-Euler) and 6.2 (the composite-rigid-body algorithm).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

INNER: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": {"contract", "nsz"},
    "_nrt": False,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}
"""for functions that compiled functions call: no allocation, no entrance for Python"""
INLINED: dict[str, Any] = {**INNER, "forceinline": True}
"""for those that are called most: a call hands all arrays over one by one, which takes longer"""


class Scratch(NamedTuple):
    """Arrays that one evaluation fills, of a chain of J joints."""

    R: np.ndarray
    """(J, 3, 3), takes the body's frame to the world's [-]"""
    o: np.ndarray
    """(J, 3), point of the joint [m]"""
    S: np.ndarray
    """(J, 6), motion of the joint at unit velocity"""
    m: np.ndarray
    """(J,), mass [kg]"""
    h: np.ndarray
    """(J, 3), first moment [kg m]"""
    I: np.ndarray  # noqa: E741  the field's letter
    """(J, 6), inertia about the origin: xx, yy, zz, xy, xz, yz [kg m^2]"""
    V: np.ndarray
    """(J, 6), velocity"""
    A: np.ndarray
    """(J, 6), acceleration, less gravity"""
    F: np.ndarray
    """(J, 6), force through the joint"""
    M: np.ndarray
    """(J, J), mass matrix; its Cholesky factor after `factorise`"""
    bias: np.ndarray
    """(J,), forces that keep the joints' velocities constant [N or N m]"""
    zero: np.ndarray
    """(J,), zeros"""
    x: np.ndarray
    """(J,), work space"""
    load: np.ndarray
    """(J,), work space: the forces of the actuators at their joints [N or N m]"""


def scratch(joints: int, *lanes: int) -> Scratch:
    """Room for one evaluation, or for one in each of some lanes."""
    shapes = [(3, 3), (3,), (6,), (), (3,), *[(6,)] * 4, (joints,), (), (), (), ()]
    return Scratch(*(np.zeros((joints, *shape, *lanes)) for shape in shapes))


@njit(**INNER)
def place(chains, s, q, w):
    """Where the bodies of chain s are at joint positions q: R, o, S and inertia m, h, I."""
    F, axis = chains.rotation, chains.axis
    for j in range(len(q)):
        p = chains.parent[j]
        x, y, z = axis[j, 0], axis[j, 1], axis[j, 2]
        sin, cos = 0.0, 1.0
        if not chains.slides[j]:
            sin, cos = math.sin(q[j]), math.cos(q[j])
        v = 1.0 - cos
        # Rodrigues' formula
        t00, t01, t02 = cos + x * x * v, x * y * v - z * sin, x * z * v + y * sin
        t10, t11, t12 = y * x * v + z * sin, cos + y * y * v, y * z * v - x * sin
        t20, t21, t22 = z * x * v - y * sin, z * y * v + x * sin, cos + z * z * v
        g0, g1, g2 = chains.origin[s, j, 0], chains.origin[s, j, 1], chains.origin[s, j, 2]
        for i in range(3):
            f0, f1, f2 = F[j, i, 0], F[j, i, 1], F[j, i, 2]
            o = chains.origin[s, j, i]
            if p >= 0:
                r0, r1, r2 = w.R[p, i, 0], w.R[p, i, 1], w.R[p, i, 2]
                f0 = r0 * F[j, 0, 0] + r1 * F[j, 1, 0] + r2 * F[j, 2, 0]
                f1 = r0 * F[j, 0, 1] + r1 * F[j, 1, 1] + r2 * F[j, 2, 1]
                f2 = r0 * F[j, 0, 2] + r1 * F[j, 1, 2] + r2 * F[j, 2, 2]
                o = w.o[p, i] + r0 * g0 + r1 * g1 + r2 * g2
            w.R[j, i, 0] = f0 * t00 + f1 * t10 + f2 * t20
            w.R[j, i, 1] = f0 * t01 + f1 * t11 + f2 * t21
            w.R[j, i, 2] = f0 * t02 + f1 * t12 + f2 * t22
            a = f0 * x + f1 * y + f2 * z
            w.S[j, i] = a  # of a hinge, for now
            w.o[j, i] = o + a * q[j] if chains.slides[j] else o
        a0, a1, a2 = w.S[j, 0], w.S[j, 1], w.S[j, 2]
        o0, o1, o2 = w.o[j, 0], w.o[j, 1], w.o[j, 2]
        if chains.slides[j]:
            w.S[j, 0], w.S[j, 1], w.S[j, 2] = 0.0, 0.0, 0.0
            w.S[j, 3], w.S[j, 4], w.S[j, 5] = a0, a1, a2
        else:  # v = o x a
            w.S[j, 3] = o1 * a2 - o2 * a1
            w.S[j, 4] = o2 * a0 - o0 * a2
            w.S[j, 5] = o0 * a1 - o1 * a0
        weigh(chains, s, j, w)


@njit(**INNER)
def weigh(chains, s, j, w):
    """Mass, first moment and inertia about the origin of body j, where it is."""
    m = chains.mass[s, j]
    k0, k1, k2 = chains.center[s, j, 0], chains.center[s, j, 1], chains.center[s, j, 2]
    c0 = w.o[j, 0] + w.R[j, 0, 0] * k0 + w.R[j, 0, 1] * k1 + w.R[j, 0, 2] * k2
    c1 = w.o[j, 1] + w.R[j, 1, 0] * k0 + w.R[j, 1, 1] * k1 + w.R[j, 1, 2] * k2
    c2 = w.o[j, 2] + w.R[j, 2, 0] * k0 + w.R[j, 2, 1] * k1 + w.R[j, 2, 2] * k2
    w.m[j] = m
    w.h[j, 0], w.h[j, 1], w.h[j, 2] = m * c0, m * c1, m * c2
    I = chains.inertia  # noqa: E741
    xx, yy, zz = I[s, j, 0, 0], I[s, j, 1, 1], I[s, j, 2, 2]
    xy, xz, yz = I[s, j, 0, 1], I[s, j, 0, 2], I[s, j, 1, 2]
    r00, r01, r02 = w.R[j, 0, 0], w.R[j, 0, 1], w.R[j, 0, 2]
    r10, r11, r12 = w.R[j, 1, 0], w.R[j, 1, 1], w.R[j, 1, 2]
    r20, r21, r22 = w.R[j, 2, 0], w.R[j, 2, 1], w.R[j, 2, 2]
    # R I, and then R I R^T + m (c.c 1 - c c^T)
    b00 = r00 * xx + r01 * xy + r02 * xz
    b01 = r00 * xy + r01 * yy + r02 * yz
    b02 = r00 * xz + r01 * yz + r02 * zz
    b10 = r10 * xx + r11 * xy + r12 * xz
    b11 = r10 * xy + r11 * yy + r12 * yz
    b12 = r10 * xz + r11 * yz + r12 * zz
    b20 = r20 * xx + r21 * xy + r22 * xz
    b21 = r20 * xy + r21 * yy + r22 * yz
    b22 = r20 * xz + r21 * yz + r22 * zz
    w.I[j, 0] = b00 * r00 + b01 * r01 + b02 * r02 + m * (c1 * c1 + c2 * c2)
    w.I[j, 1] = b10 * r10 + b11 * r11 + b12 * r12 + m * (c0 * c0 + c2 * c2)
    w.I[j, 2] = b20 * r20 + b21 * r21 + b22 * r22 + m * (c0 * c0 + c1 * c1)
    w.I[j, 3] = b00 * r10 + b01 * r11 + b02 * r12 - m * c0 * c1
    w.I[j, 4] = b00 * r20 + b01 * r21 + b02 * r22 - m * c0 * c2
    w.I[j, 5] = b10 * r20 + b11 * r21 + b12 * r22 - m * c1 * c2


@njit(**INNER)
def momentum(w, j, x0, x1, x2, v0, v1, v2):
    """Moment and force of the inertia of body j under a motion."""
    h0, h1, h2, m = w.h[j, 0], w.h[j, 1], w.h[j, 2], w.m[j]
    return (
        w.I[j, 0] * x0 + w.I[j, 3] * x1 + w.I[j, 4] * x2 + h1 * v2 - h2 * v1,
        w.I[j, 3] * x0 + w.I[j, 1] * x1 + w.I[j, 5] * x2 + h2 * v0 - h0 * v2,
        w.I[j, 4] * x0 + w.I[j, 5] * x1 + w.I[j, 2] * x2 + h0 * v1 - h1 * v0,
        m * v0 - (h1 * x2 - h2 * x1),
        m * v1 - (h2 * x0 - h0 * x2),
        m * v2 - (h0 * x1 - h1 * x0),
    )


@njit(**INNER)
def forces(chains, s, dq, ddq, w, tau):
    """Inverse dynamics of the bodies where `place` left them.

    tau[j] are the forces at the joints [N or N m] that give accelerations ddq at velocities dq.
    """
    J = len(dq)
    for j in range(J):
        p = chains.parent[j]
        for i in range(6):
            w.V[j, i] = w.S[j, i] * dq[j] + (w.V[p, i] if p >= 0 else 0.0)
        x0, x1, x2, v0, v1, v2 = w.V[j, 0], w.V[j, 1], w.V[j, 2], w.V[j, 3], w.V[j, 4], w.V[j, 5]
        s0, s1, s2, s3, s4, s5 = w.S[j, 0], w.S[j, 1], w.S[j, 2], w.S[j, 3], w.S[j, 4], w.S[j, 5]
        d, e = dq[j], ddq[j]
        # A_j = A_p + V_j x S_j q' + S_j q''
        w.A[j, 0] = d * (x1 * s2 - x2 * s1) + e * s0
        w.A[j, 1] = d * (x2 * s0 - x0 * s2) + e * s1
        w.A[j, 2] = d * (x0 * s1 - x1 * s0) + e * s2
        w.A[j, 3] = d * (x1 * s5 - x2 * s4 + v1 * s2 - v2 * s1) + e * s3
        w.A[j, 4] = d * (x2 * s3 - x0 * s5 + v2 * s0 - v0 * s2) + e * s4
        w.A[j, 5] = d * (x0 * s4 - x1 * s3 + v0 * s1 - v1 * s0) + e * s5
        if p >= 0:
            for i in range(6):
                w.A[j, i] += w.A[p, i]
        else:
            for i in range(3):
                w.A[j, 3 + i] -= chains.gravity[s, i]
        l0, l1, l2, p0, p1, p2 = momentum(w, j, x0, x1, x2, v0, v1, v2)
        n0, n1, n2, f0, f1, f2 = momentum(
            w, j, w.A[j, 0], w.A[j, 1], w.A[j, 2], w.A[j, 3], w.A[j, 4], w.A[j, 5]
        )
        # F = I A + V x* I V
        w.F[j, 0] = n0 + x1 * l2 - x2 * l1 + v1 * p2 - v2 * p1
        w.F[j, 1] = n1 + x2 * l0 - x0 * l2 + v2 * p0 - v0 * p2
        w.F[j, 2] = n2 + x0 * l1 - x1 * l0 + v0 * p1 - v1 * p0
        w.F[j, 3] = f0 + x1 * p2 - x2 * p1
        w.F[j, 4] = f1 + x2 * p0 - x0 * p2
        w.F[j, 5] = f2 + x0 * p1 - x1 * p0
    for j in range(J - 1, -1, -1):
        p = chains.parent[j]
        total = chains.armature[s, j] * ddq[j]
        for i in range(6):
            total += w.S[j, i] * w.F[j, i]
            if p >= 0:
                w.F[p, i] += w.F[j, i]
        tau[j] = total


@njit(**INNER)
def mass_matrix(chains, s, w):
    """M(q) of the bodies where `place` left them; their inertias become those of all they carry."""
    J = len(w.m)
    for j in range(J - 1, -1, -1):
        p = chains.parent[j]
        if p >= 0:
            w.m[p] += w.m[j]
            for i in range(3):
                w.h[p, i] += w.h[j, i]
            for i in range(6):
                w.I[p, i] += w.I[j, i]
        n0, n1, n2, f0, f1, f2 = momentum(
            w, j, w.S[j, 0], w.S[j, 1], w.S[j, 2], w.S[j, 3], w.S[j, 4], w.S[j, 5]
        )
        for k in range(j):
            w.M[j, k] = 0.0
        k = j
        while k >= 0:
            w.M[j, k] = (
                w.S[k, 0] * n0
                + w.S[k, 1] * n1
                + w.S[k, 2] * n2
                + w.S[k, 3] * f0
                + w.S[k, 4] * f1
                + w.S[k, 5] * f2
            )
            k = chains.parent[k]
        w.M[j, j] += chains.armature[s, j]


@njit(**INNER)
def linearise(chains, s, q, dq, w):
    """M(q) and bias(q, dq) of M q'' + bias = tau."""
    place(chains, s, q, w)
    forces(chains, s, dq, w.zero, w, w.bias)
    mass_matrix(chains, s, w)


@njit(**INLINED)
def factorise(w):
    """Puts the Cholesky factor of M in its place."""
    for j in range(len(w.m)):  # M = L L^T
        for k in range(j + 1):
            total = w.M[j, k]
            for i in range(k):
                total -= w.M[j, i] * w.M[k, i]
            w.M[j, k] = math.sqrt(total) if j == k else total / w.M[k, k]


@njit(**INLINED)
def solve(w, x):
    """Replaces x by M^-1 x, after `factorise`."""
    J = len(x)
    for j in range(J):
        for k in range(j):
            x[j] -= w.M[j, k] * x[k]
        x[j] /= w.M[j, j]
    for j in range(J - 1, -1, -1):
        for k in range(j + 1, J):
            x[j] -= w.M[k, j] * x[k]
        x[j] /= w.M[j, j]
