"""Motions of arms: sums of sinusoids in all joints at once, and targets from posture to posture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from jaxtyping import Bool, Float

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
    time: Float[np.ndarray, " N"], kinds: Sequence[str], rng: np.random.Generator
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


HOME = (0.0, -0.9, 1.3, -0.4, 0.0, 0.0)
"""about which postures lie, at joints that are called base, shoulder, elbow, wrist 1 to 3 [rad]"""
REACH = (2.0, 0.6, 0.8, 1.0, 1.2, 1.5)
"""how far from it [rad]"""
_LEAD_S = 1.6
"""of a motion before the log begins [s]"""


@dataclass(frozen=True)
class Move:
    """All joints from one posture to the next, and a rest."""

    start_s: float
    """[s]"""
    end_s: float
    """when the targets stand still [s]"""
    rest_s: float
    """for so long [s]"""
    moving: Bool[np.ndarray, " J"]
    """which joints take part"""


@dataclass(frozen=True)
class Targets:
    """K targets for each of J joints."""

    dt: float
    """between two of them [s]"""
    q: Float[np.ndarray, "K J"]
    """[rad]"""
    dq: Float[np.ndarray, "K J"]
    """[rad/s]"""
    ddq: Float[np.ndarray, "K J"]
    """[rad/s^2]"""
    moves: tuple[Move, ...]
    """of which they are made, in the time of the log"""
    lead: int = 0
    """how many targets come before the log begins: joints that have moved are stuck in another way
    than joints that were put where they are"""


def waypoints(
    count: int,
    rng: np.random.Generator,
    dt: float = 0.002,
    rest_s: tuple[float, float] = (0.4, 1.6),
    speed: tuple[float, float] = (0.3, 1.0),
    share: float = 0.7,
    always: int | None = None,
) -> Targets:
    """Targets through random postures; velocity and acceleration are 0 at each of them.

    There are `count` postures, and a target each dt [s]; a rest, before the first move too, lasts
    from the shortest to the longest of `rest_s` [s]. The fastest joint's mean speed in a move is
    from the least to the greatest `speed` [rad/s]. A joint takes part in a `share` of the moves
    [-]; the joint `always` does in each, by at least a third of its reach.
    """
    at = np.array(HOME)
    lead = round(_LEAD_S / dt)
    before = at + rng.uniform(0.1, 0.3, len(at)) * rng.choice([-1.0, 1.0], len(at))
    parts = [_quintic(before, at, lead, dt), _still(at, rest_s[0], dt)]
    moves: list[Move] = []
    begun = rest_s[0]
    for _ in range(count):
        to, moving = _next(at, rng, share, always)
        fastest = float(np.abs(to - at).max())
        steps = round(max(fastest / rng.uniform(*speed), 0.6) / dt)
        rest = round(rng.uniform(*rest_s) / dt) * dt
        parts += [_quintic(at, to, steps, dt), _still(to, rest, dt)]
        moves.append(Move(begun, begun + steps * dt, rest, moving))
        begun, at = begun + steps * dt + rest, to
    q, dq, ddq = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Targets(dt, q, dq, ddq, tuple(moves), lead)


def _next(
    at: np.ndarray, rng: np.random.Generator, share: float, always: int | None
) -> tuple[np.ndarray, np.ndarray]:
    """The next posture, and which joints move."""
    home, reach = np.array(HOME), np.array(REACH)
    while True:
        moving = rng.random(len(home)) < share
        if always is not None:
            moving[always] = True
        to = np.where(moving, home + reach * rng.uniform(-1.0, 1.0, len(home)), at)
        far = np.abs(to - at) > reach / 3.0
        if moving.any() and (always is None or far[always]):
            return to, moving


def _still(at: np.ndarray, seconds: float, dt: float) -> tuple[np.ndarray, ...]:
    q = np.tile(at, (round(seconds / dt), 1))
    return q, np.zeros_like(q), np.zeros_like(q)


def _quintic(start: np.ndarray, end: np.ndarray, steps: int, dt: float) -> tuple[np.ndarray, ...]:
    """The polynomial of degree 5 that starts and ends without velocity and acceleration."""
    s, T = np.arange(steps)[:, None] / steps, steps * dt
    by = end - start
    return (
        start + by * s**3 * (10.0 - 15.0 * s + 6.0 * s**2),
        by * 30.0 * s**2 * (1.0 - s) ** 2 / T,
        by * 60.0 * s * (1.0 - 3.0 * s + 2.0 * s**2) / T**2,
    )
