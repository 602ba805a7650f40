"""Random motions that excite a robot: sums of many sinusoids in each joint."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from mcpilco.bodies import SLIDE, Chain

COUNT = 200
"""sinusoids a joint"""
FASTEST = 2.0
"""largest angular velocity of a sinusoid [rad/s]"""
ANGLE, STROKE = 1.0, 0.1
"""standard deviation of the position of a hinge [rad] and of a slide [m]"""

Array = Float[np.ndarray, "T J"]


def random_motion(
    chain: Chain, rng: np.random.Generator, samples: int, dt: float = 0.05
) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations of a random motion, exactly.

    q_j(t) = sum_k a_jk sin(w_jk t + p_jk), w uniform in +-`FASTEST`, p uniform, a uniform and then
    scaled.

    Args:
        chain: whose joints.
        rng: what the sinusoids are drawn from.
        samples: T.
        dt: between samples [s].

    Reference: thesis section 3.4.1, which gives neither amplitudes nor sampling time.
    """
    shape = (COUNT, len(chain.bodies))
    size = np.array([STROKE if body.kind == SLIDE else ANGLE for body in chain.bodies])
    w, a = rng.uniform(-FASTEST, FASTEST, shape), rng.uniform(-1.0, 1.0, shape)
    a *= size / np.sqrt((a**2).sum(0) / 2.0)
    phase = dt * np.arange(samples)[:, None, None] * w + rng.uniform(0.0, 2.0 * np.pi, shape)
    sin, cos = a * np.sin(phase), a * np.cos(phase)
    return sin.sum(1), (w * cos).sum(1), -(w**2 * sin).sum(1)
