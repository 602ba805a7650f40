"""A policy's motion from hanging, polished to the boards' RealAI score in the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
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
WIDEST = 3.0
"""largest change of the logarithm of a lengthscale in a descent [-]"""
ROUGH, SHORT, FINE = 100, 100, 600
"""quasi-Newton steps: of each first policy in each loop, after each kick, and to the end"""
KEPT = 8
"""first policies that are polished to the end"""
KICKS = (0.01, 0.03, 0.1) * 4
"""random changes of weights and centres, to their mean size and their lengthscales [-]: many
motions are best among their neighbours"""
BY_COST = attrgetter("cost")

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

    Each is polished a little in each loop, and the best of them to the end, for the best after
    few steps is not the best after many. The one that is then best is kicked out of its minimum
    again and again, and polished in each loop from there.
    """
    rough = [descended(policy, loop, ROUGH) for policy in policies for loop in loops]
    kept = sorted(rough, key=BY_COST)[:KEPT]
    fine = [descended(found.policy, found.loop, FINE) for found in kept]
    best = kicked(min(fine, key=BY_COST), generator)
    again = [descended(best.policy, loop, FINE) for loop in loops]
    return min(best, *again, key=BY_COST)


def kicked(best: Polished, generator: np.random.Generator) -> Polished:
    """The best of minima beside each other: random changes of the best so far, polished."""
    for kick in KICKS:
        now = best.policy
        tried = replace(
            now,
            weights=now.weights + kick * _size(now) * generator.normal(size=now.weights.shape),
            centres=now.centres + kick * generator.normal(size=now.centres.shape),
        )
        best = min(best, descended(tried, best.loop, SHORT), key=BY_COST)
    return best


def descended(first: Gaussians, loop: Loop, iterations: int) -> Polished:
    """The policy after quasi-Newton steps of weights, centres and lengthscales."""

    def value(moves: Moves) -> tuple[float, Moves]:
        here, by = loop.cost_and_slopes(moved(first, moves))
        return here, np.concatenate([_size(first) * by[0], by[1].ravel(), by[2]])

    still = np.zeros(first.weights.size + first.centres.size + first.scales.size)
    bounds = np.full((still.size, 2), (-np.inf, np.inf))
    bounds[-first.scales.size :] = -WIDEST, WIDEST
    options: dict[str, Any] = {"maxiter": iterations, "maxcor": MEMORY, "ftol": 1e-9}
    found = minimize(value, still, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
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
