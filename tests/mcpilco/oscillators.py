"""A mass on a spring, whose motion is known in closed form, and the model that knows it."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import torch

from mcpilco.dynamics import AngleAugmentation, Delay, GPDynamics, speed_integration
from mcpilco.task import TaskSpec


def oscillator(dt: float) -> TaskSpec:
    """q'' = u - w^2 q, of which q and v are measured."""
    return TaskSpec(
        dt=dt,
        state_names=("q", "v"),
        state_units=("m", "m/s"),
        input_names=("u",),
        input_units=("N",),
        angles=(),
        start_mean=(0.0, 0.0),
        start_std=(0.1, 0.1),
        velocities=((0, 1),),
    )


def moved(state: np.ndarray, u: float, time: float, frequency: float) -> np.ndarray:
    """The motion under a constant input, in closed form."""
    w, (q, v) = frequency, state
    if w == 0.0:
        return np.array([q + time * v + time**2 / 2 * u, v + time * u])
    c, s, middle = math.cos(w * time), math.sin(w * time), u / w**2
    return np.array([middle + (q - middle) * c + v / w * s, v * c - (q - middle) * w * s])


def late(state: np.ndarray, commands: list[float], samples: float, dt: float, frequency: float):
    """Where a state is after the delay, if these commands came before, newest first."""
    whole, part = math.floor(samples), samples - math.floor(samples)
    for k in range(whole):
        if part:
            state = moved(state, commands[whole - k], part * dt, frequency)
        state = moved(state, commands[whole - k - 1], (1 - part) * dt, frequency)
    return moved(state, commands[0], part * dt, frequency) if part else state


def known_dynamics(
    delay: Delay, dt: float, frequency: float, variance: float = 0.0, noise: float = 0.1
) -> GPDynamics:
    """A model that knows exactly what the velocity does in a step.

    Args:
        delay: of the commands.
        dt: sampling time [s].
        frequency: w [rad/s].
        variance: of what it expects of the velocity [m^2/s^2].
        noise: of the velocity's change [m/s].
    """

    def mean(asked):
        q, v, u, *turned = asked.reshape(-1, asked.shape[-1]).unbind(-1)
        turned, rows = (turned or [torch.zeros_like(u)])[0], []
        for one in zip(q, v, u + delay.part * turned, u - (1 - delay.part) * turned, strict=True):
            now = np.array([float(x) for x in one[:2]])
            half = moved(now, float(one[3]), delay.part * dt, frequency)
            rows.append(moved(half, float(one[2]), (1 - delay.part) * dt, frequency) - now)
        return torch.tensor(np.array(rows)[:, 1:]).reshape(*asked.shape[:-1], 1)

    def mean_and_variance(asked):
        found = mean(asked)
        return found, torch.full_like(found, variance)

    def still(given):
        return torch.zeros_like(given[..., -1:])

    posterior = SimpleNamespace(
        mean=mean,
        mean_and_variance=mean_and_variance,
        X=torch.empty(0, 3 + (delay.part > 0)).double(),
        noise_std=torch.tensor([noise]).double(),
        after=lambda steps: SimpleNamespace(mean=mean),
    )
    return GPDynamics(
        posterior,
        AngleAugmentation(2, ()),
        speed_integration(oscillator(dt)),
        np.array([np.inf]),
        still if delay.part else None,
    )
