"""Motions that excite a robot: sums of sinusoids in all joints at once."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Float

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

    Args:
        model: whose joints; each has a range.
        rng: what frequencies, phases and shares are drawn from.
        waves: K, in each joint.
        slowest: frequency [Hz].
        fastest: frequency [Hz].
        reach: sum of a joint's amplitudes, relative to half of its range [-].
    """
    low, high = model.jnt_range.T
    shape, shares = (model.nv, waves), rng.dirichlet(np.full(waves, 3.0), model.nv)
    return Sinusoids(
        center=0.5 * (low + high),
        amplitude=0.5 * reach * (high - low)[:, None] * shares,
        frequency=rng.uniform(slowest, fastest, shape),
        phase=rng.uniform(0.0, 2.0 * np.pi, shape),
    )
