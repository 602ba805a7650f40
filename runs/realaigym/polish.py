"""A policy's motion from hanging, polished to the boards' RealAI score in the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from realaigym.adjoint import Slopes, slopes
from realaigym.equations import Row
from realaigym.motion import HANGING, Gaussians, motion, numbers
from realaigym.regulator import Regulator
from realaigym.score import cost, cost_and_slopes
from scipy.optimize import minimize

STEPS = 1250
"""of the motion that is polished, of 0.002 s: 2.5 s"""
MEMORY = 30
"""of past steps that L-BFGS keeps"""
ROUGH, SHORT, FINE = 100, 100, 600
"""quasi-Newton steps: of each first policy, after each kick, and of the best at the end"""
KICKS = (0.003, 0.01, 0.03) * 3
"""random changes of the weights, to their mean size [-]: many motions are best among their
neighbours, most by starting late"""
KEPT = 3
"""first policies that are kicked"""

Moves = Float[np.ndarray, " M"]


@dataclass(frozen=True)
class Loop:
    """Policy, regulator and plant, and a motion of them that is to score well."""

    regulator: Regulator
    plant: Row
    joint: int
    """which has the motor"""
    start: tuple[float, ...] = HANGING
    """shoulder and elbow angle, their velocities [rad, rad/s]"""
    steps: int = STEPS

    def cost(self, policy: Gaussians) -> float:
        """1 less the score of a policy's motion [-]."""
        r = self.regulator
        return cost(
            *motion(policy, r, self.plant, self.joint, self.steps, self.start), r, self.joint
        )

    def cost_and_slopes(self, policy: Gaussians) -> tuple[float, Slopes]:
        """The same, and its derivatives by the policy's numbers."""
        r = self.regulator
        went = motion(policy, r, self.plant, self.joint, self.steps, self.start)
        value, by_states, by_torques = cost_and_slopes(*went, r, self.joint)
        parts = r.dt, self.joint, self.plant, *numbers(policy, r)
        return value, slopes(*went, by_states, by_torques, *parts)


@dataclass(frozen=True)
class Polished:
    """A policy, the loop it was polished in, and 1 less its score there."""

    policy: Gaussians
    loop: Loop
    cost: float


def polished(
    policies: Sequence[Gaussians], loops: Sequence[Loop], generator: np.random.Generator
) -> Polished:
    """The policy whose motion scores best, of several policies in several loops.

    Each is polished a little in each loop; the best of them are kicked out of their minima again
    and again, and polished from there; the best that was found, to the end.
    """
    rough = [descended(policy, loop, ROUGH) for policy in policies for loop in loops]
    rough.sort(key=lambda found: found.cost)
    best = min((kicked(first, generator) for first in rough[:KEPT]), key=lambda found: found.cost)
    return descended(best.policy, best.loop, FINE)


def kicked(best: Polished, generator: np.random.Generator) -> Polished:
    """The best of minima beside each other: random changes of the best so far, polished."""
    for kick in KICKS:
        weights = best.policy.weights
        change = kick * np.abs(weights).mean() * generator.normal(size=weights.size)
        tried = descended(replace(best.policy, weights=weights + change), best.loop, SHORT)
        best = min(best, tried, key=lambda found: found.cost)
    return best


def descended(first: Gaussians, loop: Loop, iterations: int) -> Polished:
    """The policy after quasi-Newton steps of weights, centres and lengthscales."""

    def value(moves: Moves) -> tuple[float, Moves]:
        here, by = loop.cost_and_slopes(moved(first, moves))
        return here, np.concatenate([_size(first) * by[0], by[1].ravel(), by[2]])

    still = np.zeros(first.weights.size + first.centres.size + first.scales.size)
    options: dict[str, Any] = {"maxiter": iterations, "maxcor": MEMORY, "ftol": 1e-9}
    found = minimize(value, still, jac=True, method="L-BFGS-B", options=options)
    return Polished(moved(first, found.x), loop, float(found.fun))


def moved(first: Gaussians, moves: Moves) -> Gaussians:
    """The policy after changes of its weights, to their mean size, of centres and lengthscales.

    Centres move over the lengthscales; lengthscales change by the exponentials of their moves.
    """
    shape = first.centres.shape
    weights, centres, scales = np.split(moves, np.cumsum([shape[0], first.centres.size]))
    return replace(
        first,
        weights=first.weights + _size(first) * weights,
        centres=first.centres + centres.reshape(shape),
        scales=first.scales * np.exp(scales),
    )


def _size(policy: Gaussians) -> float:
    return float(np.abs(policy.weights).mean())
