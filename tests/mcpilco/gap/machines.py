"""Sound recordings of a pendulum and a cart-pole by scipy's integrator, and wrong ones of these."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.integrate import solve_ivp

from mcpilco.recordings import Recording

DT, SECONDS, GRAVITY = 0.02, 8.0, 9.82
NAMES = {
    "pendulum": (("angle", "velocity"), ("torque",)),
    "cart_pole": (("cart_position", "cart_velocity", "pole_angle", "pole_velocity"), ("force",)),
}
LIMIT = {"pendulum": 1.2, "cart_pole": 6.0}
NOISE = {"pendulum": (2e-3, 2e-2), "cart_pole": (1e-3, 1e-2, 2e-3, 2e-2)}

Slope = Callable[[float, np.ndarray, float], Sequence[float]]
"""of time, state and input"""


def pendulum(gain: float = 1.0) -> Slope:
    """A mass of 0.6 kg on a rod of 0.5 m, as the plant has it but for the gain of its motor."""

    def slope(time: float, x: np.ndarray, torque: float) -> Sequence[float]:
        total = gain * torque - 0.05 * x[1] - 0.6 * GRAVITY * 0.5 * np.sin(x[0])
        return x[1], total / (0.6 * 0.5**2)

    return slope


def cart_pole(gain: float = 1.0) -> Slope:
    """A cart of 0.5 kg and a uniform pole of 0.5 kg and 0.5 m, which hangs at 0."""

    def slope(time: float, x: np.ndarray, force: float) -> Sequence[float]:
        s, c = np.sin(x[2]), np.cos(x[2])
        mass = np.array([[1.0, 0.125 * c], [0.125 * c, 0.125 / 3.0]])
        pull = [gain * force - 0.1 * x[1] + 0.125 * x[3] ** 2 * s, -0.125 * GRAVITY * s]
        a = np.linalg.solve(mass, pull)
        return x[1], a[0], x[3], a[1]

    return slope


MACHINES = {"pendulum": pendulum, "cart_pole": cart_pole}


def recorded(
    machine: str,
    seed: int,
    gain: float = 1.0,
    command: float = 1.0,
    off: tuple[float, float] = (0.0, 0.0),
    dt: float = DT,
) -> list[Recording]:
    """Three recordings of a machine, by number of the seed; its commands are times a factor.

    While its motor is `off`, from one time [s] to another, they are recorded and do nothing. Each
    command is held for dt [s], from one sample to the next.
    """
    rng, slope = np.random.default_rng(seed), MACHINES[machine](gain)
    t = dt * np.arange(round(SECONDS / dt))
    names, noise = NAMES[machine], np.array(NOISE[machine])
    recordings = []
    for number in range(3):
        if number % 2:
            u = np.repeat(rng.uniform(-1.0, 1.0, len(t)), round(0.4 / dt))[: len(t)]
        else:
            u = np.sin(2.0 * np.pi * (0.2 + 0.1 * t) * t + rng.uniform(0.0, 6.0))
        u = command * LIMIT[machine] * u
        x, states = rng.normal(0.0, 0.2, len(noise)), []
        acting = np.where((t >= off[0]) & (t < off[1]), 0.0, u)
        for (begin, end), held in zip(itertools.pairwise([*t, t[-1] + dt]), acting, strict=True):
            states.append(x)
            x = solve_ivp(slope, (begin, end), x, "DOP853", args=(held,), rtol=1e-8).y[:, -1]
        measured = np.stack(states) + noise * rng.standard_normal((len(t), len(noise)))
        recordings.append(Recording(f"recording_{number}", t, measured, u[:, None], *names))
    return recordings


def columns(recordings: Sequence[Recording], **changed: Callable | float) -> list[Recording]:
    """The recordings with some columns changed by a function, or by a factor."""
    wrong = []
    for one in recordings:
        y, u = one.states.copy(), one.inputs.copy()
        for name, change in changed.items():
            table, c = (y, one.state_names) if name in one.state_names else (u, one.input_names)
            column = table[:, c.index(name)]
            column[:] = change(column) if callable(change) else change * column
        wrong.append(replace(one, states=y, inputs=u))
    return wrong


def swapped(recordings: Sequence[Recording], one: str, other: str) -> list[Recording]:
    """The recordings with two columns in each other's place."""
    wrong = []
    for recording in recordings:
        names = [*recording.state_names, *recording.input_names]
        table = np.hstack([recording.states, recording.inputs])
        a, b = names.index(one), names.index(other)
        table[:, [a, b]] = table[:, [b, a]]
        X = len(recording.state_names)
        wrong.append(replace(recording, states=table[:, :X], inputs=table[:, X:]))
    return wrong


def as_pendulum(cart_poles: Sequence[Recording]) -> list[Recording]:
    """A cart-pole's log, its pole mapped onto a pendulum."""
    names, inputs = NAMES["pendulum"]
    return [
        replace(one, states=one.states[:, 2:], state_names=names, input_names=inputs, resolution=())
        for one in cart_poles
    ]


def as_cart_pole(pendulums: Sequence[Recording]) -> list[Recording]:
    """A pendulum's log, mapped onto a cart and onto its pole."""
    states, inputs = NAMES["cart_pole"]
    return [
        replace(
            one,
            states=np.hstack([one.states, one.states]),
            state_names=states,
            input_names=inputs,
            resolution=(),
        )
        for one in pendulums
    ]
