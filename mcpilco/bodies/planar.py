"""Accelerations of chains, for compiled callers, in less time where a chain stays in a plane.

In the plane of x and z a motion is (omega, v_x, v_z) about the origin, omega about y; a force is
(moment, f_x, f_z). With y x (a, b) = (b, -a) and the moment of v and p about y being
v_z p_x - v_x p_z, the equations are those of `compiled`. One body, or two, one on the other, need
no arrays and no loops.
"""

from __future__ import annotations

import math

from numba import njit
from numba.extending import overload

from mcpilco.bodies.compiled import INLINED, factorise, linearise, solve
from mcpilco.bodies.pack_functions import in_quadrant
from mcpilco.bodies.packs import Pack, anywhere, lane, lanes_of, with_lane

SINE = (
    *(-1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04),
    *(2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10),
)
COSINE = (
    *(4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05),
    *(-2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11),
)
"""coefficients of z, z^2, ... with z = r^2, |r| <= pi / 4: (sin r / r - 1) and (cos r - 1 + z / 2)
/ z"""
QUARTER = 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21
"""pi / 2 in parts, of which a few thousand turns of the first two are exact"""
FAR = 1e5
"""angle beyond which these are too few [rad]"""
WORLD = (1.0, 0.0, 0.0, 0.0)
"""frame of the world: cosine and sine of its angle about y [-], x and z of its origin [m]"""


@njit(**INLINED)
def sine_and_cosine(x):
    """Sine and cosine of an angle [rad], in a third of the time of two calls.

    Reference: Ng, Kernels of sine and cosine, in Sun Microsystems' fdlibm (1993).
    """
    turns = math.floor(x * (2.0 / math.pi) + 0.5)
    r = ((x - turns * QUARTER[0]) - turns * QUARTER[1]) - turns * QUARTER[2]
    z = r * r
    odd = SINE[3] + z * (SINE[4] + z * SINE[5])
    even = COSINE[3] + z * (COSINE[4] + z * COSINE[5])
    sin = r + r * z * (SINE[0] + z * (SINE[1] + z * (SINE[2] + z * odd)))
    cos = 1.0 - 0.5 * z + z * z * (COSINE[0] + z * (COSINE[1] + z * (COSINE[2] + z * even)))
    sin, cos = in_quadrant(sin, cos, turns)
    if anywhere(abs(x) >= FAR):
        for k in range(lanes_of(x)):
            far = lane(x, k)
            if abs(far) >= FAR:
                sin, cos = with_lane(sin, k, math.sin(far)), with_lane(cos, k, math.cos(far))
    return sin, cos


@overload(math.sin)
def _sine(x):
    return (lambda x: sine_and_cosine(x)[0]) if isinstance(x, Pack) else None


@overload(math.cos)
def _cosine(x):
    return (lambda x: sine_and_cosine(x)[1]) if isinstance(x, Pack) else None


@njit(**INLINED)
def placed_in_plane(chains, s, j, q, frame):
    """Frame, motion at unit velocity, and inertia of body j at position q of its joint.

    `frame` is that of its parent; the inertia is mass, first moment and moment about the origin.
    """
    cos, sin, ox, oz = frame
    gx, gz = chains.origin[s, j, 0], chains.origin[s, j, 2]
    rc, rs = chains.rotation[j, 0, 0], chains.rotation[j, 0, 2]
    ox, oz = ox + cos * gx + sin * gz, oz - sin * gx + cos * gz
    cos, sin = cos * rc - sin * rs, sin * rc + cos * rs
    if chains.slides[j]:
        turn, sx, sz = 0.0, chains.axis[j, 0], chains.axis[j, 2]
        sx, sz = cos * sx + sin * sz, -sin * sx + cos * sz
        ox += sx * q
        oz += sz * q
    else:
        turn = chains.axis[j, 1]
        ts, tc = sine_and_cosine(q)
        cos, sin = cos * tc - sin * turn * ts, sin * tc + cos * turn * ts
        sx, sz = -turn * oz, turn * ox
    kx, kz = chains.center[s, j, 0], chains.center[s, j, 2]
    cx, cz = ox + cos * kx + sin * kz, oz - sin * kx + cos * kz
    m = chains.mass[s, j]
    inertia = m, m * cx, m * cz, chains.inertia[s, j, 1, 1] + m * (cx * cx + cz * cz)
    return (cos, sin, ox, oz), (turn, sx, sz), inertia


@njit(**INLINED)
def momentum_in_plane(inertia, motion):
    """Moment and force of an inertia under a motion."""
    m, hx, hz, about = inertia
    x, vx, vz = motion
    return about * x + hz * vx - hx * vz, m * vx + x * hz, m * vz - x * hx


@njit(**INLINED)
def carried_in_plane(S, inertia, d, velocity, ax, az):
    """Velocity and acceleration of a body, and the force that these take.

    S is the motion of its joint, d the velocity of the joint; the velocity and the acceleration
    (ax, az), less gravity, are its parent's: none about y comes from velocities in a plane.
    """
    so, sx, sz = S
    x, vx, vz = velocity
    x, vx, vz = x + d * so, vx + d * sx, vz + d * sz
    ax += d * (x * sz - so * vz)
    az += d * (so * vx - x * sx)
    _, px, pz = momentum_in_plane(inertia, (x, vx, vz))
    n, fx, fz = momentum_in_plane(inertia, (0.0, ax, az))
    return (x, vx, vz), ax, az, (n + vz * px - vx * pz, fx + x * pz, fz - x * px)


@njit(**INLINED)
def power_in_plane(S, force):
    """Of a force along a motion."""
    return S[0] * force[0] + S[1] * force[1] + S[2] * force[2]


@njit(**INLINED)
def linearise_in_plane(chains, s, q, dq, w):
    """M(q) and bias(q, dq) of M q'' + bias = tau."""
    J = len(q)
    for j in range(J):
        p = chains.parent[j]
        frame, velocity = WORLD, (0.0, 0.0, 0.0)
        ax, az = -chains.gravity[s, 0], -chains.gravity[s, 2]
        if p >= 0:
            frame = w.R[p, 0, 0], w.R[p, 0, 2], w.o[p, 0], w.o[p, 2]
            velocity, ax, az = (w.V[p, 0], w.V[p, 1], w.V[p, 2]), w.A[p, 1], w.A[p, 2]
        frame, S, inertia = placed_in_plane(chains, s, j, q[j], frame)
        velocity, ax, az, force = carried_in_plane(S, inertia, dq[j], velocity, ax, az)
        w.R[j, 0, 0], w.R[j, 0, 2], w.o[j, 0], w.o[j, 2] = frame
        w.S[j, 0], w.S[j, 1], w.S[j, 2] = S
        w.m[j], w.h[j, 0], w.h[j, 2], w.I[j, 1] = inertia
        w.V[j, 0], w.V[j, 1], w.V[j, 2] = velocity
        w.A[j, 1], w.A[j, 2] = ax, az
        w.F[j, 0], w.F[j, 1], w.F[j, 2] = force
    for j in range(J - 1, -1, -1):
        p = chains.parent[j]
        S = w.S[j, 0], w.S[j, 1], w.S[j, 2]
        w.bias[j] = power_in_plane(S, (w.F[j, 0], w.F[j, 1], w.F[j, 2]))
        force = momentum_in_plane((w.m[j], w.h[j, 0], w.h[j, 2], w.I[j, 1]), S)
        for k in range(j):
            w.M[j, k] = 0.0
        k = j
        while k >= 0:
            w.M[j, k] = power_in_plane((w.S[k, 0], w.S[k, 1], w.S[k, 2]), force)
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


@njit(**INLINED)
def accelerate_one(chains, s, q, dq, x):
    """Replaces a force x by an acceleration, of a single body in the plane."""
    ax, az = -chains.gravity[s, 0], -chains.gravity[s, 2]
    _, S, inertia = placed_in_plane(chains, s, 0, q[0], WORLD)
    _, _, _, force = carried_in_plane(S, inertia, dq[0], (0.0, 0.0, 0.0), ax, az)
    M = power_in_plane(S, momentum_in_plane(inertia, S)) + chains.armature[s, 0]
    x[0] = (x[0] - power_in_plane(S, force)) / M


@njit(**INLINED)
def accelerate_two(chains, s, q, dq, x):
    """Replaces forces x by accelerations, of a body in the plane and another one on it."""
    ax, az = -chains.gravity[s, 0], -chains.gravity[s, 2]
    frame, S0, I0 = placed_in_plane(chains, s, 0, q[0], WORLD)
    _, S1, I1 = placed_in_plane(chains, s, 1, q[1], frame)
    velocity, ax, az, f0 = carried_in_plane(S0, I0, dq[0], (0.0, 0.0, 0.0), ax, az)
    _, _, _, f1 = carried_in_plane(S1, I1, dq[1], velocity, ax, az)
    p0, p1 = momentum_in_plane(I0, S0), momentum_in_plane(I1, S1)
    both = momentum_in_plane(I1, S0)
    M10, M11 = power_in_plane(S0, p1), power_in_plane(S1, p1) + chains.armature[s, 1]
    M00 = power_in_plane(S0, p0) + power_in_plane(S0, both) + chains.armature[s, 0]
    x1 = (x[1] - power_in_plane(S1, f1)) / M11
    x0 = x[0] - power_in_plane(S0, f0) - power_in_plane(S0, f1)
    x[0] = (x0 - M10 * x1) / (M00 - M10 * M10 / M11)
    x[1] = x1 - M10 / M11 * x[0]


@njit(**INLINED)
def assemble(chains, s, q, dq, w):
    """M(q) and bias(q, dq) of M q'' + bias = tau, of a chain in a plane or not."""
    if chains.planar[0]:
        linearise_in_plane(chains, s, q, dq, w)
    else:
        linearise(chains, s, q, dq, w)


@njit(**INLINED)
def accelerate(chains, s, q, dq, w, x):
    """Replaces forces x in the joints by the accelerations that they give, M^-1 (x - bias)."""
    if chains.planar[0] and len(q) == 1:
        accelerate_one(chains, s, q, dq, x)
        return
    if chains.planar[0] and len(q) == 2 and chains.parent[1] == 0:
        accelerate_two(chains, s, q, dq, x)
        return
    assemble(chains, s, q, dq, w)
    factorise(w)
    for j in range(len(q)):
        x[j] -= w.bias[j]
    solve(w, x)
