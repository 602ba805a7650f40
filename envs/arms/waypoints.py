"""Targets of an arm's joints: from one random posture to the next, with rests between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

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
