"""Equations of motion integrated to rounding error: Gauss-Legendre collocation.

Over one panel of time the acceleration is a polynomial that satisfies the equations of motion at
the Gauss-Legendre nodes. It is found by fixed-point iteration, all nodes and all systems of a batch
at once; a panel on which the iteration does not settle, or on which the polynomial does not resolve
the motion, is halved.

Reference: Hairer, Lubich and Wanner, Geometric Numerical Integration (2006), section II.1.4.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from jaxtyping import Float
from numpy.polynomial import legendre

from mcpilco.typing import EnvError

NODES = 16
"""nodes in a panel; the method has order 32 at the end of the panel"""
ITERATIONS = 30
"""iterations after which a panel is halved; the motions of an env's step settle in about 12"""
SETTLED = 1e-13
"""largest last change of a velocity, relative to 1 + the largest velocity [-]"""
RESOLVED = 1e-10
"""largest last Legendre coefficients of an acceleration, relative to 1 + the largest one [-]"""
SHORTEST = 1e-5
"""length of the panels at which the integration is given up [s]"""

Accelerations = Callable[
    [Float[np.ndarray, "*b J"], Float[np.ndarray, "*b J"]], Float[np.ndarray, "*b J"]
]


def integrate(
    accelerations: Accelerations,
    q: Float[np.ndarray, "*b J"],
    dq: Float[np.ndarray, "*b J"],
    duration: float,
    samples: int = 1,
) -> tuple[Float[np.ndarray, "T *b J"], Float[np.ndarray, "T *b J"]]:
    """Positions and velocities at T = `samples` equally spaced times, the last one at the end.

    Args:
        accelerations: ddq as a function of q and dq, for any batch of them.
        q: positions at the start [m or rad].
        dq: velocities at the start [m/s or rad/s].
        duration: how long [s].
        samples: T, how many intermediate times to return.

    Returns:
        Positions and velocities at duration / T, 2 duration / T, ..., duration.

    Raises:
        EnvError: the motion is too fast or too stiff to follow, or is not finite.
    """
    # numbers that overflow on a panel that is too long only say that it is
    with np.errstate(over="ignore", invalid="ignore"):
        panel = _solve_panel(accelerations, q, dq, duration, samples)
    if panel is not None:
        return panel
    if duration < SHORTEST:
        raise EnvError(
            f"The motion could not be integrated over {duration:.1g} s from positions {q} and "
            f"velocities {dq}; choose physical constants and a start that move it more slowly."
        )
    if samples == 1:
        q_two, dq_two = integrate(accelerations, q, dq, duration, samples=2)
        return q_two[1:], dq_two[1:]
    cut = samples // 2
    until = duration * cut / samples
    q_front, dq_front = integrate(accelerations, q, dq, until, cut)
    q_back, dq_back = integrate(
        accelerations, q_front[-1], dq_front[-1], duration - until, samples - cut
    )
    return np.concatenate([q_front, q_back]), np.concatenate([dq_front, dq_back])


@cache
def _matrices(samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What maps a function's values at the nodes of [0, 1] to its integrals and to its tail.

    The integrals run from 0 to each node, and from 0 to each sample. The tail is the last two
    Legendre coefficients, small where the nodes resolve the function.
    """
    nodes, _ = legendre.leggauss(NODES)
    times = 2.0 * np.arange(1, samples + 1) / samples - 1.0
    coefficients = np.linalg.inv(legendre.legvander(nodes, NODES - 1))
    integrals = legendre.legint(np.eye(NODES), lbnd=-1) @ coefficients / 2.0
    to_nodes = legendre.legvander(nodes, NODES) @ integrals
    to_samples = legendre.legvander(times, NODES) @ integrals
    return to_nodes, to_samples, coefficients[-2:]


def _solve_panel(
    accelerations: Accelerations, q: np.ndarray, dq: np.ndarray, duration: float, samples: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """As `integrate` in one panel; None where the panel is too long."""
    to_nodes, to_samples, tail = _matrices(samples)

    def apply(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
        return (matrix @ values.reshape(NODES, -1)).reshape(len(matrix), *q.shape)

    # dQ = dq + h A ddQ, Q = q + h A dQ  at the nodes
    ddq_nodes = np.broadcast_to(accelerations(q, dq), (NODES, *q.shape))
    dq_nodes = dq + duration * apply(to_nodes, ddq_nodes)
    for _ in range(ITERATIONS):
        q_nodes = q + duration * apply(to_nodes, dq_nodes)
        ddq_nodes = accelerations(q_nodes, dq_nodes)
        previous, dq_nodes = dq_nodes, dq + duration * apply(to_nodes, ddq_nodes)
        change = np.abs(dq_nodes - previous).max()
        if not change > SETTLED * (1.0 + np.abs(dq_nodes).max()):
            break
    else:
        return None
    unresolved = np.abs(apply(tail, ddq_nodes)).max()
    if not unresolved <= RESOLVED * (1.0 + np.abs(ddq_nodes).max()):
        return None
    return q + duration * apply(to_samples, dq_nodes), dq + duration * apply(to_samples, ddq_nodes)
