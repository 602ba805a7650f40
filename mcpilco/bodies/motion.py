"""Forward and inverse dynamics of a chain, and its regressor, for batches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numba import njit

from mcpilco.bodies import compiled
from mcpilco.bodies.chain import Body, Chain, Chains, stack
from mcpilco.bodies.planar import accelerate
from mcpilco.compiling import digest

INERTIAL = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")
"""inertial parameters of a body, about the origin of its frame, which is in its joint: mass [kg],
first moment [kg m], inertia [kg m^2]"""
ByJoint = Float[np.ndarray, "N J"]
"""for each joint, at N samples: positions q [m or rad], velocities dq [m/s or rad/s],
accelerations ddq [m/s^2 or rad/s^2], forces tau at the joints [N or N m]"""


def accelerations(chain: Chain, q: ByJoint, dq: ByJoint, tau: ByJoint) -> ByJoint:
    """q'' = M(q)^-1 (tau - bias(q, q')) [m/s^2 or rad/s^2]."""
    arrays = (np.ascontiguousarray(array, float) for array in (q, dq, tau))
    return _accelerations(stack([chain]), compiled.scratch(len(chain.bodies)), *arrays)


def generalised_forces(chain: Chain, q: ByJoint, dq: ByJoint, ddq: ByJoint) -> ByJoint:
    """tau = M(q) q'' + bias(q, q') [N or N m]: inverse dynamics, see `accelerations`."""
    arrays = (np.ascontiguousarray(array, float) for array in (q, dq, ddq))
    return _generalised_forces(stack([chain]), compiled.scratch(len(chain.bodies)), *arrays)


def mass_matrix(chain: Chain, q: ByJoint) -> Float[np.ndarray, "N J J"]:
    """M(q) [kg, kg m or kg m^2]: the forces that unit accelerations take, without gravity."""
    weightless = replace(chain, gravity=(0.0, 0.0, 0.0))
    rest = np.zeros_like(q)
    columns = [generalised_forces(weightless, q, rest, rest + row) for row in np.eye(q.shape[1])]
    return np.stack(columns, axis=2)


def regressor(chain: Chain, q: ByJoint, dq: ByJoint, ddq: ByJoint) -> Float[np.ndarray, "N J J 10"]:
    """Y of tau[n, j] = sum_k Y[n, j, k] theta_k, theta_k the `INERTIAL` parameters of body k.

    Without the motors' armature. In the frame of body k, whose origin accelerates by a (less
    gravity) while the body turns with w and accelerates its turning by w', the body takes

        force  = m a + w' x h + w x (w x h)
        moment = I w' + w x (I w) + h x a

    and joint j, that carries it, feels both along the joint's axis.

    Reference: Atkeson, An, Hollerbach, Estimation of inertial parameters of manipulator loads and
        links, International Journal of Robotics Research 5 (3), 1986.
    """
    arrays = (np.ascontiguousarray(array, float) for array in (q, dq, ddq))
    return _regressor(stack([chain]), compiled.scratch(len(chain.bodies)), *arrays)


def inertial_parameters(body: Body) -> Float[np.ndarray, " 10"]:
    """The `INERTIAL` parameters of a body [kg, kg m, kg m^2]: Steiner's theorem."""
    c = np.array(body.center)
    inertia = np.array(body.inertia) + body.mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.concatenate([[body.mass], body.mass * c, inertia[np.triu_indices(3)]])


@njit(**compiled.INNER)
def _wrench(w0, w1, w2, b0, b1, b2, a0, a1, a2, F, N):
    """Force F[3, 10] and moment N[3, 10] for unit parameters; b is w', all in the frame."""
    F[0, 0], F[1, 0], F[2, 0] = a0, a1, a2
    # [w'x] + [w x][w x]
    F[0, 1], F[0, 2], F[0, 3] = -w1 * w1 - w2 * w2, w0 * w1 - b2, w0 * w2 + b1
    F[1, 1], F[1, 2], F[1, 3] = w0 * w1 + b2, -w0 * w0 - w2 * w2, w1 * w2 - b0
    F[2, 1], F[2, 2], F[2, 3] = w0 * w2 - b1, w1 * w2 + b0, -w0 * w0 - w1 * w1
    # h x a = -[a x] h
    N[0, 2], N[0, 3] = a2, -a1
    N[1, 1], N[1, 3] = -a2, a0
    N[2, 1], N[2, 2] = a1, -a0
    # I w' + w x (I w), I = xx xy xz yy yz zz
    N[0, 4], N[0, 5], N[0, 6] = b0, b1 - w0 * w2, b2 + w0 * w1
    N[0, 7], N[0, 8], N[0, 9] = -w1 * w2, w1 * w1 - w2 * w2, w1 * w2
    N[1, 4], N[1, 5], N[1, 6] = w0 * w2, b0 + w1 * w2, w2 * w2 - w0 * w0
    N[1, 7], N[1, 8], N[1, 9] = b1, b2 - w0 * w1, -w0 * w2
    N[2, 4], N[2, 5], N[2, 6] = -w0 * w1, w0 * w0 - w1 * w1, b0 - w1 * w2
    N[2, 7], N[2, 8], N[2, 9] = w0 * w1, b1 + w0 * w2, b2


@njit(**compiled.INNER)
def _fill(chains, dq, ddq, w, unused, F, N, Y):
    """Y[J, J, 10] at one sample, the bodies where `place` left them."""
    compiled.forces(chains, 0, dq, ddq, w, unused)  # V and A, about the origin of the world
    for k in range(len(dq)):
        R, o = w.R[k], w.o[k]
        x0, x1, x2 = w.V[k, 0], w.V[k, 1], w.V[k, 2]
        b0, b1, b2 = w.A[k, 0], w.A[k, 1], w.A[k, 2]
        v0 = w.V[k, 3] + x1 * o[2] - x2 * o[1]
        v1 = w.V[k, 4] + x2 * o[0] - x0 * o[2]
        v2 = w.V[k, 5] + x0 * o[1] - x1 * o[0]
        # a = A_v + w' x o + w x v, of the point that is in the joint
        a0 = w.A[k, 3] + b1 * o[2] - b2 * o[1] + x1 * v2 - x2 * v1
        a1 = w.A[k, 4] + b2 * o[0] - b0 * o[2] + x2 * v0 - x0 * v2
        a2 = w.A[k, 5] + b0 * o[1] - b1 * o[0] + x0 * v1 - x1 * v0
        _wrench(
            R[0, 0] * x0 + R[1, 0] * x1 + R[2, 0] * x2,
            R[0, 1] * x0 + R[1, 1] * x1 + R[2, 1] * x2,
            R[0, 2] * x0 + R[1, 2] * x1 + R[2, 2] * x2,
            R[0, 0] * b0 + R[1, 0] * b1 + R[2, 0] * b2,
            R[0, 1] * b0 + R[1, 1] * b1 + R[2, 1] * b2,
            R[0, 2] * b0 + R[1, 2] * b1 + R[2, 2] * b2,
            R[0, 0] * a0 + R[1, 0] * a1 + R[2, 0] * a2,
            R[0, 1] * a0 + R[1, 1] * a1 + R[2, 1] * a2,
            R[0, 2] * a0 + R[1, 2] * a1 + R[2, 2] * a2,
            F,
            N,
        )
        j = k
        while j >= 0:  # the joints that carry body k
            s0, s1, s2 = w.S[j, 0], w.S[j, 1], w.S[j, 2]
            t0 = w.S[j, 3] + s1 * o[2] - s2 * o[1]
            t1 = w.S[j, 4] + s2 * o[0] - s0 * o[2]
            t2 = w.S[j, 5] + s0 * o[1] - s1 * o[0]
            n0 = R[0, 0] * s0 + R[1, 0] * s1 + R[2, 0] * s2
            n1 = R[0, 1] * s0 + R[1, 1] * s1 + R[2, 1] * s2
            n2 = R[0, 2] * s0 + R[1, 2] * s1 + R[2, 2] * s2
            f0 = R[0, 0] * t0 + R[1, 0] * t1 + R[2, 0] * t2
            f1 = R[0, 1] * t0 + R[1, 1] * t1 + R[2, 1] * t2
            f2 = R[0, 2] * t0 + R[1, 2] * t1 + R[2, 2] * t2
            for p in range(10):
                Y[j, k, p] = (
                    n0 * N[0, p]
                    + n1 * N[1, p]
                    + n2 * N[2, p]
                    + f0 * F[0, p]
                    + f1 * F[1, p]
                    + f2 * F[2, p]
                )
            j = chains.parent[j]


def _compiled(source: str):
    """The loops over samples, compiled anew when the digest of the source code changes."""

    @njit(cache=True, error_model="numpy")
    def forward(chains: Chains, w, q, dq, tau):
        source  # noqa: B018  closed over
        ddq = tau.copy()
        for n in range(len(q)):
            accelerate(chains, 0, q[n], dq[n], w, ddq[n])
        return ddq

    @njit(cache=True, error_model="numpy")
    def inverse(chains: Chains, w, q, dq, ddq):
        source  # noqa: B018  closed over
        tau = np.empty_like(q)
        for n in range(len(q)):
            compiled.place(chains, 0, q[n], w)
            compiled.forces(chains, 0, dq[n], ddq[n], w, tau[n])
        return tau

    @njit(cache=True, error_model="numpy")
    def columns(chains: Chains, w, q, dq, ddq):
        source  # noqa: B018  closed over
        J = q.shape[1]
        Y = np.zeros((len(q), J, J, 10))
        F, N, unused = np.zeros((3, 10)), np.zeros((3, 10)), np.empty(J)
        for n in range(len(q)):
            compiled.place(chains, 0, q[n], w)
            _fill(chains, dq[n], ddq[n], w, unused, F, N, Y[n])
        return Y

    return forward, inverse, columns


_accelerations, _generalised_forces, _regressor = _compiled(digest("bodies"))
