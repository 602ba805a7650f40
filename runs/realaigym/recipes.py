"""How the policies of each robot are learned: the trials, their costs and horizons."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

STEPS = 100
"""of an episode, of 0.02 s: 2 s"""


@dataclass(frozen=True)
class Stage:
    """A trial, and the search in it."""

    cost: Mapping[str, Any]
    """numbers of the `SwingCost`"""
    horizon: int = STEPS
    """of the particles [steps]"""
    rate: float = 1.0
    """factor of the learning rates [-]"""
    near: float = 0.0
    """share of the particles that start near hanging [-]"""


def efforts(
    share: float, torque: float, velocity: float, power: float = 0.0, jumps: float = 0.0
) -> dict[str, float]:
    """A share of the weights of torque, velocity, power and jumps."""
    names = ("torque", "velocity", "power", "jumps")
    return {n: share * w for n, w in zip(names, (torque, velocity, power, jumps), strict=True)}


@dataclass(frozen=True)
class Recipe:
    """How the policies of a robot are learned, and where its regulator acts."""

    lengthscales: tuple[float, float, float]
    """of the cost [rad]"""
    robust: tuple[Stage, ...]
    """for the policy that swings up from anywhere"""
    thrifty: tuple[Stage, ...]
    """from there to policies of the motion from hanging"""
    weight: float
    """half range of the weights of the first policy [-]"""
    room: float
    """of the regulator behind the robust policy [-]"""


CAUGHT = {"near": 0.4, "energy": 0.3}
LITTLE = (0.12, 0.006, 0.04, 0.6)
"""efforts' weights, about as the score has them; 0.4 of them are a twentieth of what it says"""
INFINITE = 1e9
RECIPES: Mapping[str, Recipe] = {
    "pendubot": Recipe(
        lengthscales=(1.5, 0.75, INFINITE),
        robust=tuple(Stage(efforts(s, 2.0 / 36.0, 0.01)) for s in (0.05, 0.15, 0.4, 1.0)),
        thrifty=tuple(
            Stage({**CAUGHT, **efforts(s, *LITTLE), "anneals": False}, 90, rate, 0.7)
            for s, rate in ((0.2, 0.4), (0.3, 0.3))
        ),
        weight=0.3,
        room=6.3,
    ),
    "acrobot": Recipe(
        lengthscales=(1.5, INFINITE, 1.5),
        robust=tuple(
            Stage({**CAUGHT, **efforts(s, 0.08, 0.002, 0.0, 0.1)}, horizon, rate)
            for s, horizon, rate in (
                (0.05, 50, 1.0),
                (0.1, 75, 0.6),
                (0.1, 75, 0.4),
                (0.1, 75, 0.4),
            )
        ),
        thrifty=tuple(
            Stage({**CAUGHT, **efforts(s, *LITTLE), "anneals": False}, 80, rate, 0.5)
            for s, rate in ((0.2, 0.4), (0.4, 0.3))
        ),
        weight=0.05,
        room=6.3,
    ),
}
"""chosen on seed 0"""
