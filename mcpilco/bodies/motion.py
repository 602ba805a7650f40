"""Forward and inverse dynamics of a chain, for batches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numba import njit

from mcpilco.bodies import compiled
from mcpilco.bodies.chain import Chain, Chains, stack
from mcpilco.bodies.planar import linearise_in_plane
from mcpilco.compiling import digest


def accelerations(
    chain: Chain,
    q: Float[np.ndarray, "N J"],
    dq: Float[np.ndarray, "N J"],
    tau: Float[np.ndarray, "N J"],
) -> Float[np.ndarray, "N J"]:
    """q'' = M(q)^-1 (tau - bias(q, q')) [m/s^2 or rad/s^2].

    Args:
        chain: whose.
        q: joint positions [m or rad].
        dq: joint velocities [m/s or rad/s].
        tau: forces at the joints [N or N m].
    """
    arrays = (np.ascontiguousarray(array, float) for array in (q, dq, tau))
    return _accelerations(stack([chain]), compiled.scratch(len(chain.bodies)), *arrays)


def generalised_forces(
    chain: Chain,
    q: Float[np.ndarray, "N J"],
    dq: Float[np.ndarray, "N J"],
    ddq: Float[np.ndarray, "N J"],
) -> Float[np.ndarray, "N J"]:
    """tau = M(q) q'' + bias(q, q') [N or N m]: inverse dynamics, see `accelerations`."""
    arrays = (np.ascontiguousarray(array, float) for array in (q, dq, ddq))
    return _generalised_forces(stack([chain]), compiled.scratch(len(chain.bodies)), *arrays)


def mass_matrix(chain: Chain, q: Float[np.ndarray, "N J"]) -> Float[np.ndarray, "N J J"]:
    """M(q) [kg, kg m or kg m^2]: the forces that unit accelerations take, without gravity."""
    weightless = replace(chain, gravity=(0.0, 0.0, 0.0))
    rest = np.zeros_like(q)
    columns = [generalised_forces(weightless, q, rest, rest + row) for row in np.eye(q.shape[1])]
    return np.stack(columns, axis=2)


def _compiled(source: str):
    """Both loops, compiled anew when the digest of the source code changes."""

    @njit(cache=True, error_model="numpy")
    def forward(chains: Chains, w, q, dq, tau):
        source  # noqa: B018  closed over
        ddq = tau.copy()
        for n in range(len(q)):
            if chains.planar[0]:
                linearise_in_plane(chains, 0, q[n], dq[n], w)
            else:
                compiled.linearise(chains, 0, q[n], dq[n], w)
            compiled.factorise(w)
            ddq[n] -= w.bias
            compiled.solve(w, ddq[n])
        return ddq

    @njit(cache=True, error_model="numpy")
    def inverse(chains: Chains, w, q, dq, ddq):
        source  # noqa: B018  closed over
        tau = np.empty_like(q)
        for n in range(len(q)):
            compiled.place(chains, 0, q[n], w)
            compiled.forces(chains, 0, dq[n], ddq[n], w, tau[n])
        return tau

    return forward, inverse


_accelerations, _generalised_forces = _compiled(digest("bodies"))
