"""A seed chooses plant, hidden effects, their sizes, excitation and noise; recordings come out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from truth import (
    ARMATURE,
    CART_POLE,
    CONSTANT,
    COS,
    COULOMB,
    COUPLING,
    CUBIC,
    DETENT,
    DOUBLE_PENDULUM,
    DRAG,
    EXTRA,
    FEED,
    MINUS,
    NUMBERS,
    PATCH,
    PENDULUM,
    PLUS,
    SIN,
    SPEED,
    SPRING,
    VISCOUS,
    WAVES,
    simulate,
)

RECORDINGS, SECONDS, DT = 6, 10.0, 0.02
NOISE = {"m": 1e-3, "rad": 2e-3}
GRAVITY = 9.82


@dataclass(frozen=True)
class System:
    """A nominal plant of ours, in the terms of the other simulator."""

    kind: int
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    drives: tuple[int, ...]
    limit: tuple[float, ...]
    """largest command of each input"""
    body: tuple[tuple[float, ...], ...]
    """mass, first moment, inertia about the joint, length"""
    viscous: tuple[float, ...]
    force: tuple[float, ...]
    """usual at each joint"""
    speed: tuple[float, ...]
    slides: tuple[bool, ...]


SYSTEMS = {
    "mcpilco/CartPoleSwingUp-v0": System(
        CART_POLE,
        ("cart_position", "cart_velocity", "pole_angle", "pole_velocity"),
        ("force",),
        ("cart", "pole"),
        ("cart", "pole"),
        (0,),
        (6.0,),
        ((0.5, 0.0, 0.0, 0.0), (0.5, 0.125, 0.5 * 0.25 / 3, 0.5)),
        (0.1, 0.0),
        (3.0, 0.6),
        (0.8, 4.0),
        (True, False),
    ),
    "mcpilco/Pendulum-v0": System(
        PENDULUM,
        ("angle", "velocity"),
        ("torque",),
        ("pendulum",),
        ("pendulum",),
        (0,),
        (1.5,),
        ((0.6, 0.3, 0.15, 0.5),),
        (0.05,),
        (1.2,),
        (4.0,),
        (False,),
    ),
    "mcpilco/DoublePendulum-v0": System(
        DOUBLE_PENDULUM,
        ("shoulder_angle", "shoulder_velocity", "elbow_angle", "elbow_velocity"),
        ("shoulder_torque", "elbow_torque"),
        ("shoulder", "elbow"),
        ("upper", "lower"),
        (0, 1),
        (1.5, 0.5),
        ((0.6, 0.09, 0.6 * 0.09 / 3, 0.3), (0.4, 0.06, 0.4 * 0.09 / 3, 0.3)),
        (0.01, 0.01),
        (1.2, 0.35),
        (4.0, 5.0),
        (False, False),
    ),
}


@dataclass(frozen=True)
class Case:
    """What is hidden, and what was recorded."""

    seed: int
    plant: str
    effects: tuple[dict[str, Any], ...]
    """name, target and parameters of each; name `outside` for what is not in the catalogue"""
    velocities: bool
    recordings: tuple[dict[str, np.ndarray], ...]
    """columns by name"""


def joint_effects(system: System, rng: np.random.Generator, size: float):
    """An effect in a joint."""
    j = int(rng.integers(len(system.joints)))
    f, v = size * system.force[j], system.speed[j]
    reach = 1.0 if system.slides[j] else 2.0
    part = rng.uniform(0.05, 0.15)
    forms = {
        "viscous_friction": {VISCOUS: part * f / v},
        "coulomb_friction": {COULOMB: part * f},
        "stribeck_friction": {
            COULOMB: part * f,
            EXTRA: rng.uniform(0.5, 1.0) * part * f,
            SPEED: rng.uniform(0.03, 0.1) * v,
        },
        "quadratic_drag": {DRAG: part * f / v**2},
        "asymmetric_friction": {PLUS: 1.5 * part * f, MINUS: 0.5 * part * f},
        "spring": {SPRING: part * f / reach},
        "hardening_spring": {CUBIC: part * f / reach**3},
        "constant_force": {CONSTANT: rng.choice([-1, 1]) * part * f},
        "position_ripple": {
            SIN: part * f,
            COS: part * f * rng.uniform(-1, 1),
            WAVES: rng.uniform(4, 20) / reach,
        },
        "armature": {ARMATURE: rng.uniform(0.1, 0.3) * size * (system.body[j][0] if system.slides[j] else system.body[j][2])},
    }
    return j, forms


JOINT = (
    "viscous_friction", "coulomb_friction", "stribeck_friction", "quadratic_drag",
    "asymmetric_friction", "spring", "hardening_spring", "constant_force", "position_ripple", "armature",
)
BODY = ("body_mass", "center_of_mass", "body_inertia")
ACTUATOR = ("actuator_gain", "actuator_dead_zone", "actuator_saturation", "actuator_delay", "actuator_lag", "backlash")
SENSOR = ("sensor_offset", "sensor_scale", "sensor_delay")
OUTSIDE = {"detent": DETENT, "feed": FEED, "patch": PATCH, "coupling": COUPLING}


def draw(seed: int, *, plant: str | None = None, count: int = 1, size: float = 1.0, names=None, outside: bool = False) -> Case:
    """The case of a seed."""
    rng = np.random.default_rng(seed)
    plant = plant or str(rng.choice(list(SYSTEMS)))
    system = SYSTEMS[plant]
    J, U = len(system.joints), len(system.inputs)
    body = np.array(system.body)
    joint = np.zeros((J, NUMBERS))
    joint[:, VISCOUS] = system.viscous
    actuator = np.tile([1.0, 0.0, np.inf, 0.0, 0.0, 0.0], (U, 1))
    sensor = {}
    chosen = []
    pool = list(names or (*JOINT, *BODY, *ACTUATOR, *SENSOR))
    for name in rng.choice(pool, size=min(count, len(pool)), replace=False):
        chosen.append(hide(str(name), system, rng, size, body, joint, actuator, sensor))
    if outside:
        kinds = [k for k in OUTSIDE if not (k == "coupling" and J == 1)]
        kind = str(rng.choice(kinds))
        j = 0 if kind == "coupling" else int(rng.integers(J))
        joint[j, OUTSIDE[kind]] = rng.uniform(0.15, 0.4) * system.force[j]
        chosen.append({"name": "outside", "kind": kind, "target": system.joints[j]})
    velocities = bool(rng.integers(2))
    width = float(rng.uniform(1e-3, 4e-3))
    recordings = []
    for number in range(RECORDINGS):
        commands = np.stack([excitation(rng, system.limit[u], number) for u in range(U)], axis=1)
        start = np.array([rng.normal(0, 0.1 if k % 2 == 0 else 0.3) for k in range(2 * J)])
        states = simulate(system.kind, start, commands, DT, body, joint, actuator, np.array(system.drives), GRAVITY, width)
        if not np.isfinite(states).all() or np.abs(states).max() > 1e3:
            return draw(seed + 100000, plant=plant, count=count, size=size, names=names, outside=outside)
        recordings.append(measure(system, states, commands, sensor, velocities, rng, simulate, start, body, joint, actuator, width))
    return Case(seed, plant, tuple(chosen), velocities, tuple(recordings))


def hide(name, system, rng, size, body, joint, actuator, sensor) -> dict[str, Any]:
    """Puts an effect into the arrays; says what it is."""
    if name in JOINT:
        j, forms = joint_effects(system, rng, size)
        for number, value in forms[name].items():
            joint[j, number] += value
        return {"name": name, "target": system.joints[j], "parameters": {str(k): float(v) for k, v in forms[name].items()}}
    if name in BODY:
        hinges = [j for j in range(len(system.bodies)) if not system.slides[j]]
        j = int(rng.integers(len(system.bodies))) if name == "body_mass" else int(rng.choice(hinges))
        part = size * rng.uniform(0.1, 0.3) * rng.choice([-1, 1])
        if name == "body_mass":
            value = part * body[j, 0]
            body[j, :3] *= 1.0 + part
        elif name == "center_of_mass":
            m, h, inertia, _ = body[j]
            c = h / m
            value = part * c
            body[j, 1] = m * (c + value)
            body[j, 2] = inertia - m * c**2 + m * (c + value) ** 2
        else:
            value = abs(part) * body[j, 2]
            body[j, 2] += value
        return {"name": name, "target": system.bodies[j], "parameters": {"value": float(value)}}
    if name in ACTUATOR:
        u = int(rng.integers(len(system.inputs)))
        limit = system.limit[u]
        part = rng.uniform(0.05, 0.15) * size
        value = {
            "actuator_gain": 1.0 + 2 * part * rng.choice([-1, 1]),
            "actuator_dead_zone": part * limit,
            "actuator_saturation": (1.0 - 3 * part) * limit,
            "actuator_delay": rng.uniform(0.01, 0.05) * size,
            "actuator_lag": rng.uniform(0.01, 0.08) * size,
            "backlash": part * limit,
        }[name]
        actuator[u, ACTUATOR.index(name)] = value
        target = "actuator" if len(system.inputs) == 1 else system.inputs[u]
        return {"name": name, "target": target, "parameters": {"value": float(value)}}
    positions = [k for k in range(0, len(system.states), 2)]
    if name == "sensor_offset":  # the zero of a cart's position can be seen by nothing
        positions = [k for k in positions if not system.slides[k // 2]]
    k = int(rng.choice(positions))
    value = {
        "sensor_offset": rng.uniform(0.03, 0.1) * size * rng.choice([-1, 1]),
        "sensor_scale": 1.0 + rng.uniform(0.03, 0.1) * size * rng.choice([-1, 1]),
        "sensor_delay": rng.uniform(0.01, 0.05) * size,
    }[name]
    sensor[k] = (name, value)
    return {"name": name, "target": system.states[k], "parameters": {"value": float(value)}}


def measure(system, states, commands, sensor, velocities, rng, simulate, start, body, joint, actuator, width) -> dict[str, np.ndarray]:
    """The columns of a recording."""
    T = len(states)
    t = DT * np.arange(T)
    columns = {"time": t}
    y = states.copy()
    for k, (name, value) in sensor.items():
        if name == "sensor_offset":
            y[:, k] += value
        elif name == "sensor_scale":
            y[:, k] *= value
        else:
            q, v = states[:, k], states[:, k + 1]
            from scipy.interpolate import CubicHermiteSpline

            y[:, k] = CubicHermiteSpline(t, q, v)(np.maximum(t - value, 0.0))
    for k, name in enumerate(system.states):
        noise = NOISE["m" if system.slides[k // 2] else "rad"] * (1.0 if k % 2 == 0 else 10.0)
        if k % 2 == 0 or velocities:
            columns[name] = y[:, k] + noise * rng.standard_normal(T)
    for u, name in enumerate(system.inputs):
        columns[name] = commands[:, u]
    return columns


def excitation(rng: np.random.Generator, limit: float, number: int) -> np.ndarray:
    """Commands: chirp, multisine, steps, or small and slow."""
    T = round(SECONDS / DT)
    t = DT * np.arange(T)
    kind = number % 4
    if kind == 0:
        f0, f1 = rng.uniform(0.1, 0.3), rng.uniform(1.5, 3.0)
        x = np.sin(2 * np.pi * (f0 * t + (f1 - f0) * t**2 / (2 * SECONDS)) + rng.uniform(0, 6))
    elif kind == 1:
        x = sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in rng.uniform(0.2, 2.5, 6)) / 2.5
    elif kind == 2:
        x = np.repeat(rng.uniform(-1, 1, T), rng.integers(10, 30))[:T]
    else:
        x = 0.4 * np.sin(2 * np.pi * rng.uniform(0.2, 0.5) * t) + 0.3 * np.repeat(rng.uniform(-1, 1, T), 25)[:T]
    return np.clip(x, -1, 1) * limit * rng.uniform(0.6, 1.0)
