"""Motions that excite a robot: sums of sinusoids in all joints at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

from envs.arms.dh import Kind
from mcpilco.bodies import SLIDE, Chain

RAMP_S = 1.0
"""time in which the motion swells from rest [s]"""


@dataclass(frozen=True)
class Sinusoids:
    """q_j(t) = c_j + r(t) sum_k a_jk sin(2 pi f_jk t + p_jk), r from 0 to 1 within `RAMP_S`."""

    center: Float[np.ndarray, " J"]
    """c [rad or m]"""
    amplitude: Float[np.ndarray, "J K"]
    """a [rad or m]"""
    frequency: Float[np.ndarray, "J K"]
    """f [Hz]"""
    phase: Float[np.ndarray, "J K"]
    """p [rad]"""

    def at(
        self, time: Float[np.ndarray, " T"]
    ) -> tuple[Float[np.ndarray, "T J"], Float[np.ndarray, "T J"], Float[np.ndarray, "T J"]]:
        """Positions, velocities and accelerations at times from 0 [s] on."""
        w = 2.0 * np.pi * self.frequency
        angle = w * time[:, None, None] + self.phase
        s, ds, dds = (
            (self.amplitude * wave).sum(axis=2)
            for wave in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle))
        )
        r, dr, ddr = (part[:, None] for part in _swell(np.minimum(time / RAMP_S, 1.0)))
        q = self.center + r * s
        return q, dr * s + r * ds, ddr * s + 2.0 * dr * ds + r * dds


def _swell(x: Float[np.ndarray, " T"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """10 x^3 - 15 x^4 + 6 x^5, from 0 at rest to 1 at rest, and its derivatives in time."""
    r = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    dr = 30.0 * x**2 * (1.0 - x) ** 2 / RAMP_S
    return r, dr, 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / RAMP_S**2


def random_sinusoids(
    model: mujoco.MjModel,
    rng: np.random.Generator,
    *,
    waves: int = 3,
    slowest: float = 0.1,
    fastest: float = 1.2,
    reach: float = 0.6,
) -> Sinusoids:
    """Sinusoids of random frequency and phase about the middle of each joint's range.

    Frequencies are in [Hz]; `reach` is the sum of a joint's amplitudes, relative to half of its
    range [-].
    """
    low, high = model.jnt_range.T
    shape, shares = (model.nv, waves), rng.dirichlet(np.full(waves, 3.0), model.nv)
    return Sinusoids(
        center=0.5 * (low + high),
        amplitude=0.5 * reach * (high - low)[:, None] * shares,
        frequency=rng.uniform(slowest, fastest, shape),
        phase=rng.uniform(0.0, 2.0 * np.pi, shape),
    )


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

    Reference: thesis section 3.4.1, which gives neither amplitudes nor sampling time.
    """
    shape = (COUNT, len(chain.bodies))
    size = np.array([STROKE if body.kind == SLIDE else ANGLE for body in chain.bodies])
    w, a = rng.uniform(-FASTEST, FASTEST, shape), rng.uniform(-1.0, 1.0, shape)
    a *= size / np.sqrt((a**2).sum(0) / 2.0)
    phase = dt * np.arange(samples)[:, None, None] * w + rng.uniform(0.0, 2.0 * np.pi, shape)
    sin, cos = a * np.sin(phase), a * np.cos(phase)
    return sin.sum(1), (w * cos).sum(1), -(w**2 * sin).sum(1)


RANGES = {"hinge": 2.0, "slide": 0.3}
"""half the range of a joint [rad or m]"""
_SINES = 10


def sinusoids(
    time: Float[np.ndarray, " N"], kinds: Sequence[Kind], rng: np.random.Generator
) -> Float[np.ndarray, "N J"]:
    """Each joint moves by a sum of ten sinusoids of random amplitudes, frequencies and phases.

    The slowest sinusoid has a period of as long as the time [s] spans; a joint's largest deflection
    is its range.

    Reference: thesis section 2.6.1.
    """
    shape = _SINES, len(kinds)
    amplitudes = rng.uniform(0.0, 1.0, shape)
    cycles = rng.uniform(1.0, 15.0, shape) / np.ptp(time)
    phases = rng.uniform(0.0, 2 * np.pi, shape)
    q = (amplitudes * np.sin(2 * np.pi * cycles * time[:, None, None] + phases)).sum(1)
    return q / np.abs(q).max(0) * np.array([RANGES[kind] for kind in kinds])
