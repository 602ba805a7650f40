"""Recordings of a pendulum with a hidden effect, made by scipy's integrator and no code of ours."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from mcpilco.recordings import Recording

MASS, LENGTH, FRICTION, GRAVITY = 0.6, 0.5, 0.05, 9.82
DT, SECONDS, STD = 0.02, 10.0, 2e-3
NAMES = ("angle", "velocity"), ("torque",)

Force = Callable[[float, float], float]
"""of angle and velocity [N m]"""


def dry_friction(size: float) -> Force:
    """Coulomb's, of so many N m, which turns over smoothly."""
    return lambda q, v: -size * v / float(np.hypot(v, 2e-3))


def hidden(rng: np.random.Generator) -> tuple[str, dict[str, float], Force]:
    """An effect that a seed chooses: name, parameters, force."""
    size = rng.uniform(0.05, 0.15)
    forces: dict[str, tuple[dict[str, float], Force]] = {
        "coulomb_friction": ({"f_c": size}, dry_friction(size)),
        "quadratic_drag": ({"c": 0.05 * size}, lambda q, v: -0.05 * size * v * abs(v)),
        "spring": ({"k": size}, lambda q, v: -size * q),
        "hardening_spring": ({"k_3": size}, lambda q, v: -size * q**3),
        "constant_force": ({"f_0": size}, lambda q, v: size),
    }
    name = str(rng.choice(list(forces)))
    return name, *forces[name]


Outside = Callable[[float], float]
"""torque that depends on time alone [N m]: a hand, the wind"""


def record(
    rng: np.random.Generator,
    force: Force,
    number: int,
    gain: float = 1.0,
    delay: float = 0.0,
    outside: Outside = lambda time: 0.0,
    dt: float = DT,
    std: float = STD,
) -> Recording:
    """Ten seconds under torques of several kinds; positions only, with noise of `std` [rad]."""
    t = dt * np.arange(round(SECONDS / dt))
    if number % 2:
        torque = np.repeat(rng.uniform(-1.2, 1.2, len(t)), 20)[: len(t)]
    else:
        torque = 1.2 * np.sin(2 * np.pi * (0.2 + 0.1 * t) * t + rng.uniform(0, 6))

    def slope(time: float, x: np.ndarray) -> tuple[float, float]:
        held = torque[max(int((time - delay) / dt + 1e-9), 0)]
        total = (
            outside(time) + gain * held - FRICTION * x[1] - MASS * GRAVITY * LENGTH * np.sin(x[0])
        )
        return x[1], (total + force(x[0], x[1])) / (MASS * LENGTH**2)

    x, states = np.array([rng.normal(0, 0.3), 0.0]), []
    for k in range(len(t)):
        states.append(x)
        parts = [t[k], t[k] + delay % dt, t[k] + dt] if delay % dt else [t[k], t[k] + dt]
        for begin, end in itertools.pairwise(parts):
            span = (begin + 1e-7, end - 1e-7)  # the torque jumps at both ends
            x = solve_ivp(slope, span, x, rtol=1e-6, atol=1e-8, max_step=2e-3).y[:, -1]
    seen = np.stack(states)
    angle = seen[:, 0] + std * rng.standard_normal(len(t))
    measured = np.stack([angle, np.full(len(t), np.nan)], axis=1)
    return Recording(f"recording_{number}", t, measured, torque[:, None], *NAMES)
