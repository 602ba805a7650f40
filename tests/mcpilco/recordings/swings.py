"""Noisy recordings of a cart-pole under random forces, with the truth."""

from __future__ import annotations

from functools import cache

import numpy as np

from mcpilco.recordings import Recording
from tests.mcpilco.recordings.logs import INPUTS, PAIRS, STATES
from tests.reference.cartpole import CartPoleDynamics

DT = 0.02
SUBSTEPS = 2
NOISE = np.array([1e-3, 1e-2, 2e-3, 2e-2])
"""1 mm, 1 cm/s, 2 mrad, 20 mrad/s"""


COUNT = 12
"""systems of each kind"""
KINDS = {(1, 6.0): 0, (5, 6.0): 1, (25, 6.0): 2, (25, 2.0): 3}
"""of (samples that a force is held, its largest value [N])"""


def swings(hold: int = 5, amplitude: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    """States of 12 cart-poles for 10 s at 50 Hz, (T, 12, 4), and their forces, (T, 12).

    A new random force comes every `hold` samples; at 6 N the pole reaches 100 rad/s^2.
    """
    states, forces = _all_swings()
    these = slice(COUNT * KINDS[hold, amplitude], COUNT * (KINDS[hold, amplitude] + 1))
    return states[:, these], forces[:, these]


@cache
def _all_swings() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    dynamics = CartPoleDynamics.nominal(
        cart_mass=0.5, pole_mass=0.5, pole_length=0.5, cart_friction=0.1, gravity=9.82
    )
    state = 0.3 * rng.standard_normal((COUNT * len(KINDS), 4))
    hold, amplitude = (np.repeat(values, COUNT) for values in zip(*KINDS, strict=True))
    force = np.zeros(len(state))
    states, forces = [], []
    for k in range(500):
        fresh = amplitude * rng.uniform(-1, 1, len(state))
        force = np.where(k % hold == 0, fresh, force)
        states.append(state)
        forces.append(force)
        for _ in range(SUBSTEPS):
            state = _step(dynamics, state, force, DT / SUBSTEPS)
    return np.array(states), np.array(forces)


def _step(dynamics: CartPoleDynamics, x: np.ndarray, force: np.ndarray, h: float) -> np.ndarray:
    """Runge and Kutta's, of fourth order."""
    a = dynamics.derivative(x, force)
    b = dynamics.derivative(x + h / 2 * a, force)
    c = dynamics.derivative(x + h / 2 * b, force)
    d = dynamics.derivative(x + h * c, force)
    return x + h / 6 * (a + 2 * b + 2 * c + d)


def recording(states: np.ndarray, force: np.ndarray, **options) -> Recording:
    options = {"velocities": PAIRS} | options
    time = DT * np.arange(len(states))
    return Recording("swing", time, states, force[:, None], STATES, INPUTS, **options)
