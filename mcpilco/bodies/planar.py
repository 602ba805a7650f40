"""`mcpilco.bodies.compiled` for chains that stay in the plane of x and z: a third of the work.

A motion is (omega, v_x, v_z) about the origin, omega about y; a force is (moment, f_x, f_z). With
y x (a, b) = (b, -a) and the moment of v and p about y being v_z p_x - v_x p_z, the equations are
those of the three-dimensional module.
"""

from __future__ import annotations

import math

from numba import njit

from mcpilco.bodies.compiled import INLINED


@njit(**INLINED)
def place_in_plane(chains, s, q, w):
    """Where the bodies are: o, S, m, h, I[j, 1]; R holds cosine and sine of their angle about y."""
    for j in range(len(q)):
        p = chains.parent[j]
        ox, oz = chains.origin[s, j, 0], chains.origin[s, j, 2]
        cos, sin = chains.rotation[j, 0, 0], chains.rotation[j, 0, 2]
        if p >= 0:
            pc, ps = w.R[p, 0, 0], w.R[p, 0, 2]
            ox, oz = w.o[p, 0] + pc * ox + ps * oz, w.o[p, 2] - ps * ox + pc * oz
            cos, sin = pc * cos - ps * sin, ps * cos + pc * sin
        if chains.slides[j]:
            ax = cos * chains.axis[j, 0] + sin * chains.axis[j, 2]
            az = -sin * chains.axis[j, 0] + cos * chains.axis[j, 2]
            ox += ax * q[j]
            oz += az * q[j]
            w.S[j, 0], w.S[j, 1], w.S[j, 2] = 0.0, ax, az
        else:
            turn = chains.axis[j, 1]
            tc, ts = math.cos(q[j]), turn * math.sin(q[j])
            cos, sin = cos * tc - sin * ts, sin * tc + cos * ts
            w.S[j, 0], w.S[j, 1], w.S[j, 2] = turn, -turn * oz, turn * ox
        w.R[j, 0, 0], w.R[j, 0, 2], w.o[j, 0], w.o[j, 2] = cos, sin, ox, oz
        kx, kz = chains.center[s, j, 0], chains.center[s, j, 2]
        cx, cz = ox + cos * kx + sin * kz, oz - sin * kx + cos * kz
        m = chains.mass[s, j]
        w.m[j], w.h[j, 0], w.h[j, 2] = m, m * cx, m * cz
        w.I[j, 1] = chains.inertia[s, j, 1, 1] + m * (cx * cx + cz * cz)


@njit(**INLINED)
def momentum_in_plane(w, j, x, vx, vz):
    """Moment and force of the inertia of body j under a motion."""
    m, hx, hz = w.m[j], w.h[j, 0], w.h[j, 2]
    return w.I[j, 1] * x + hz * vx - hx * vz, m * vx + x * hz, m * vz - x * hx


@njit(**INLINED)
def linearise_in_plane(chains, s, q, dq, w):
    """M(q) and bias(q, dq) of M q'' + bias = tau."""
    J = len(q)
    place_in_plane(chains, s, q, w)
    for j in range(J):
        p, d = chains.parent[j], dq[j]
        so, sx, sz = w.S[j, 0], w.S[j, 1], w.S[j, 2]
        x, vx, vz = d * so, d * sx, d * sz
        ax, az = -chains.gravity[s, 0], -chains.gravity[s, 2]
        if p >= 0:
            x, vx, vz = x + w.V[p, 0], vx + w.V[p, 1], vz + w.V[p, 2]
            ax, az = w.A[p, 1], w.A[p, 2]
        w.V[j, 0], w.V[j, 1], w.V[j, 2] = x, vx, vz
        # no angular acceleration about y comes from velocities in a plane
        ax += d * (x * sz - so * vz)
        az += d * (so * vx - x * sx)
        w.A[j, 1], w.A[j, 2] = ax, az
        _, px, pz = momentum_in_plane(w, j, x, vx, vz)
        n, fx, fz = momentum_in_plane(w, j, 0.0, ax, az)
        w.F[j, 0], w.F[j, 1], w.F[j, 2] = n + vz * px - vx * pz, fx + x * pz, fz - x * px
    for j in range(J - 1, -1, -1):
        p = chains.parent[j]
        n, fx, fz = w.F[j, 0], w.F[j, 1], w.F[j, 2]
        w.bias[j] = w.S[j, 0] * n + w.S[j, 1] * fx + w.S[j, 2] * fz
        n, px, pz = momentum_in_plane(w, j, w.S[j, 0], w.S[j, 1], w.S[j, 2])
        for k in range(j):
            w.M[j, k] = 0.0
        k = j
        while k >= 0:
            w.M[j, k] = w.S[k, 0] * n + w.S[k, 1] * px + w.S[k, 2] * pz
            k = chains.parent[k]
        w.M[j, j] += chains.armature[s, j]
        if p >= 0:
            w.F[p, 0] += w.F[j, 0]
            w.F[p, 1] += w.F[j, 1]
            w.F[p, 2] += w.F[j, 2]
            w.m[p] += w.m[j]
            w.h[p, 0] += w.h[j, 0]
            w.h[p, 2] += w.h[j, 2]
            w.I[p, 1] += w.I[j, 1]
