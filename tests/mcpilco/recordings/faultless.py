"""Simulated recordings without any fault: fast swings, stops, friction, coarse and fine samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from envs.plants import acrobot, cart_pole, pendubot, pendulum
from mcpilco.plant import Plant

FINE, SAMPLES = 1e-3, 500
"""step of the truth [s], and samples of a recording"""
STEPS_MS = (1, 2, 5, 10, 20, 50)
"""sampling times [ms]"""
SENSORS = ("exact", "noise", "encoder", "filtered encoder")
COMMANDS = ("chirp", "swing up", "square wave")
FILTER_S = 0.02
"""time constant of the filter behind an encoder [s]"""
PLANTS = (cart_pole, pendulum, pendubot, acrobot)
LIMIT = {"cart_pole": 12.0, "pendulum": 3.0, "pendubot": 6.0, "acrobot": 6.0, "drive": 40.0}
MACHINES = tuple(LIMIT)


@dataclass(frozen=True)
class Faultless:
    """A sensor's readings of a motion; columns are positions and velocities in turn."""

    name: str
    dt: float
    """sampling time [s]"""
    states: np.ndarray
    """(SAMPLES, X)"""


def recordings(count: int = 40, seed: int = 0) -> Iterator[Faultless]:
    """So many, with machines, sensors, commands and sampling times mixed."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        machine, sensor = MACHINES[k % len(MACHINES)], SENSORS[k // len(MACHINES) % len(SENSORS)]
        command, dt = COMMANDS[k % len(COMMANDS)], 1e-3 * STEPS_MS[k % len(STEPS_MS)]
        every = round(dt / FINE)
        u = LIMIT[machine] * _command(command, FINE * np.arange(SAMPLES * every), rng)
        named = {plant.__name__: plant for plant in PLANTS}
        fine = _drive(u, rng) if machine == "drive" else _swing(named[machine](), u, rng)
        measured = _sensed(fine, sensor, every, rng)
        yield Faultless(f"{machine}, {sensor}, {command}, {1e3 * dt:g} ms", dt, measured)


def _command(kind: str, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Commands in [-1, 1]."""
    if kind == "chirp":
        return np.sin(2 * np.pi * (0.2 * t + 0.5 * 5.0 * t**2 / t[-1]))
    if kind == "swing up":  # near the frequency of a pendulum, which it brings over the top
        return np.sign(np.sin(2 * np.pi * rng.uniform(0.5, 1.0) * t))
    return np.repeat(rng.uniform(-1.0, 1.0, len(t)), 300)[: len(t)]


def _swing(plant: Plant, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Of a plant of equations."""
    start = rng.normal(0.0, 0.3, (1, len(plant.layout.states)))
    return plant.simulate(start, u[None, :, None], FINE)[0, :-1]


def _drive(u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A slide of 10 kg with Coulomb friction of 5 N between stops, from which it may bounce."""
    bounce, stop, mass, friction = rng.choice([0.0, 0.8]), 0.2, 10.0, 5.0
    x = v = 0.0
    states = []
    for force in u.tolist():
        free = v + FINE * force / mass
        slowed = FINE * friction / mass
        v = np.sign(free) * max(abs(free) - slowed, 0.0)
        x += FINE * v
        if abs(x) > stop:
            x, v = np.sign(x) * stop, -bounce * v
        states.append((x, v))
    return np.array(states)


def _sensed(fine: np.ndarray, sensor: str, every: int, rng: np.random.Generator) -> np.ndarray:
    """The log of a motion; the encoder's velocity is that of its counts."""
    states = fine.copy()
    if "encoder" in sensor:
        step = 2.0 * np.pi / rng.choice([1024, 4096])
        states[:, 0::2] = step * np.round(states[:, 0::2] / step)
        slope = np.diff(states[:, 0::2], axis=0, prepend=states[:1, 0::2]) / FINE
        share = FINE / FILTER_S
        if sensor == "filtered encoder":
            states[:, 1::2] = lfilter([share], [1.0, share - 1.0], slope, axis=0)
    states = states[::every]
    if sensor == "encoder":
        slope = np.diff(states[:, 0::2], axis=0, prepend=states[:1, 0::2])
        states[:, 1::2] = slope / (every * FINE)
    if sensor == "noise":
        states += [1e-3, 1e-2] * (states.shape[1] // 2) * rng.standard_normal(states.shape)
    return states
