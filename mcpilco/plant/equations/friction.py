"""Dry friction that the steps of an integration can follow.

Dry friction turns over within millimetres a second: at rest it damps a joint hundreds of times a
second. An explicit step that is longer than that leaps over rest, and its derivatives grow from
step to step, so that a policy learns nothing from them.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from jaxtyping import Float

from mcpilco.plant.effects import CATALOGUE
from mcpilco.plant.effects.joint import DryFriction
from mcpilco.plant.equations.chain import ZERO, inverse_dynamics

STABLE = 2.0
"""damping rate times step that a Runge-Kutta step bears well; it leaps beyond 2.8 [-]"""
POSES = 16
"""that show how little inertia a joint can have"""

DRY = {effect.law: effect for effect in CATALOGUE.values() if isinstance(effect, DryFriction)}
"""dry frictions by their law, whose constants are their values"""


def followable(known: SimpleNamespace, system: Any, step: float) -> None:
    """Let the dry friction of a system turn over no faster than its steps can follow, in place.

    The friction of a joint that turns over within w [m/s or rad/s] damps it by f / (w m) a second
    near rest, where m is the joint's inertia. `w` is raised to where this is `STABLE` a step;
    steps that are short enough leave it.

    Args:
        known: the system in plain numbers, at its nominal parameters.
        system: the same as numbers of a tape; the constants of its laws are changed.
        step: longest of the integration [s].
    """
    friction = np.zeros(len(known.origin))
    for law, joint, constants in known.laws:
        if law in DRY:
            friction[joint] += sum(abs(constants[i]) for i in DRY[law].forces)
    if not friction.any():
        return
    slowest = friction * most_mobile(known) * step / STABLE
    for law, joint, constants in system.laws:
        if law in DRY:
            turn = DRY[law].turn
            constants[turn] = max(float(constants[turn]), float(slowest[joint]))


def most_mobile(known: SimpleNamespace) -> Float[np.ndarray, " J"]:
    """Most acceleration at a joint for a unit force there, over some poses [1/kg, 1/(kg m^2)]."""
    J = len(known.origin)
    rest, unit = [0.0] * J, np.eye(J).tolist()
    poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSES, J)).tolist()
    inertias = np.array(
        [[inverse_dynamics(known, q, rest, ddq, ZERO) for ddq in unit] for q in poses]
    )
    return np.diagonal(np.linalg.inv(inertias), axis1=1, axis2=2).max(0)
