"""A seed chooses plant, hidden effects, their sizes, excitation and noise; recordings come out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from felt import Machine, Made
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import lfilter, lsim
from systems import SYSTEMS, System
from truth import (
    ARMATURE,
    BACKWARD,
    BRAKE,
    CABLE,
    CONSTANT,
    COS,
    COULOMB,
    COUPLING,
    CUBIC,
    DAMPING,
    DETENT,
    DOUBLE_PENDULUM,
    DRAG,
    EXTRA,
    FEED,
    FORWARD,
    GAP,
    INDUCTANCE,
    LOAD,
    MINUS,
    NUMBERS,
    PATCH,
    PLUS,
    REACH,
    ROTARY_PENDULUM,
    ROTOR,
    SIN,
    SPEED,
    SPRING,
    STEP,
    STIFFNESS,
    TILT,
    VISCOUS,
    WAVES,
    simulate,
)

RECORDINGS, SECONDS, DT = 6, 10.0, 0.02
NOISE = {"m": 1e-3, "rad": 2e-3}
GRAVITY = 9.82
AGAIN = 1_000_000
"""from one seed to the next that is drawn in its place"""


@dataclass(frozen=True)
class Case:
    """The hidden effects of a seed, and their recordings."""

    seed: int
    plant: str
    effects: tuple[dict[str, Any], ...]
    """name, target and parameters of each; name `outside` for what is not in the catalogue"""
    velocities: bool
    recordings: tuple[dict[str, np.ndarray], ...]
    """columns by name"""
    besides: tuple[tuple[str, str], ...]
    """what is there too and may be named, as the spring of a cable; names and targets"""
    made: Made
    """the machine, and how it moved in the recordings"""
    lacking: tuple[Machine, ...]
    """the same without each of its effects"""

    def beyond(self, uncertainty: float) -> list[float]:
        """Noise std by which motions with each effect leave all that parameters could do."""
        return [self.made.apart(without, uncertainty) for without in self.lacking]


def joint_effects(system: System, rng: np.random.Generator, size: float):
    """A joint, and for each effect in it its symbols: where they go, and how large."""
    j = int(rng.integers(len(system.joints)))
    f, v = size * system.force[j], system.speed[j]
    reach = 1.0 if system.slides[j] else 2.0
    part = rng.uniform(0.05, 0.15)
    inertia = system.body[j][0] if system.slides[j] else system.body[j][2]
    forms = {
        "viscous_friction": {"b": (VISCOUS, part * f / v)},
        "coulomb_friction": {"f_c": (COULOMB, part * f)},
        "stribeck_friction": {
            "f_c": (COULOMB, part * f),
            "f_d": (EXTRA, rng.uniform(0.5, 1.0) * part * f),
            "v_s": (SPEED, rng.uniform(0.03, 0.1) * v),
        },
        "quadratic_drag": {"c": (DRAG, part * f / v**2)},
        "asymmetric_friction": {"f_p": (PLUS, 1.5 * part * f), "f_n": (MINUS, 0.5 * part * f)},
        "spring": {"k": (SPRING, part * f / reach)},
        "hardening_spring": {"k_3": (CUBIC, part * f / reach**3)},
        "constant_force": {"f_0": (CONSTANT, rng.choice([-1, 1]) * part * f)},
        "position_ripple": {
            "s": (SIN, part * f),
            "c": (COS, part * f * rng.uniform(-1, 1)),
            "n": (WAVES, rng.uniform(4, 20) / reach),
        },
        "armature": {"I_a": (ARMATURE, rng.uniform(0.1, 0.3) * size * inertia)},
        "asymmetric_viscous_friction": {
            "b_p": (FORWARD, 1.5 * part * f / v),
            "b_n": (BACKWARD, 0.5 * part * f / v),
        },
    }
    return j, forms


JOINT = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "quadratic_drag",
    "asymmetric_friction",
    "spring",
    "hardening_spring",
    "constant_force",
    "position_ripple",
    "armature",
)
BODY = ("body_mass", "center_of_mass", "body_inertia")
DRY = ("coulomb_friction", "stribeck_friction", "asymmetric_friction", "constant_force")
"""forces that depend on the direction of a motion at most: two of them add up to a third"""
ACTUATOR = (
    "actuator_gain",
    "actuator_dead_zone",
    "actuator_saturation",
    "actuator_delay",
    "actuator_lag",
    "backlash",
)
SENSOR = ("sensor_offset", "sensor_scale", "sensor_delay")
FURTHER = (
    "asymmetric_viscous_friction",
    "load_dependent_friction",
    "body_length",
    "asymmetric_dead_zone",
    "actuator_rate_limit",
    "sensor_lag",
    "eccentric_encoder",
    "gravity_tilt",
    "dahl_friction",
    "back_emf",
    "elastic_joint",
    "joint_backlash",
)
"""of the catalogue too, in a tier of their own: the draws of the others stay what they were"""
SYMBOL = {
    "body_mass": "m_d",
    "center_of_mass": "c_d",
    "body_inertia": "I_d",
    "actuator_gain": "k",
    "actuator_dead_zone": "d",
    "actuator_saturation": "u_m",
    "actuator_delay": "d",
    "actuator_lag": "T",
    "backlash": "p",
    "sensor_offset": "o",
    "sensor_scale": "k",
    "sensor_delay": "d",
}
OUTSIDE = {"detent": DETENT, "feed": FEED, "patch": PATCH, "coupling": COUPLING}


@dataclass(frozen=True)
class Tier:
    """A kind of case."""

    effects: int
    """hidden effects of the catalogue"""
    size: tuple[float, float] = (1.0, 1.0)
    """range of their size; 1 is ordinary"""
    outside: bool = False
    """whether one is hidden that is not in the catalogue"""
    laboratory: bool = False
    """parameters off by 1 to 3 %, noise correlated, stamps that jitter, outliers, feedback"""
    rough: bool = False
    """besides, a cable, encoders that count and samples that are lost; up to three effects"""
    pool: tuple[str, ...] = (*JOINT, *BODY, *ACTUATOR, *SENSOR)
    """of the effects"""
    uncertainty: float = 0.01
    """relative std of masses, lengths, frictions and gains, as the workflow is told"""
    dt: float = 0.02
    """sampling time to which its recordings are brought [s]"""


TIERS = {
    "one": Tier(1),
    "weak": Tier(1, (1 / 30, 1 / 10), uncertainty=0.0001),
    "two": Tier(2),
    "three": Tier(3),
    "none": Tier(0),
    "outside": Tier(0, outside=True),
    "laboratory-one": Tier(1, laboratory=True, uncertainty=0.03),
    "laboratory-none": Tier(0, laboratory=True, uncertainty=0.03),
    "sparse-one": Tier(1, dt=0.1),
    "sparse-none": Tier(0, dt=0.1),
    "further": Tier(1, pool=FURTHER),
    "rough": Tier(3, laboratory=True, rough=True, uncertainty=0.03),
}


def draw(seed: int, tier: Tier, plant: str | None = None) -> Case:
    """The case of a seed; drawn anew where a motion runs away, or effects are not felt or alike."""
    for anew in itertools.count():
        case = attempt(np.random.default_rng(seed + AGAIN * anew), seed, tier, plant)
        if case is not None:
            return case
    raise AssertionError


def attempt(rng: np.random.Generator, seed: int, tier: Tier, plant: str | None) -> Case | None:
    plant = plant or str(rng.choice(list(SYSTEMS)))
    system = SYSTEMS[plant]
    J, U = len(system.joints), len(system.inputs)
    machine = nominal(system)
    if tier.laboratory:
        part = 1.0 + rng.uniform(0.01, 0.03, (J, 1)) * rng.choice([-1, 1], (J, 1))
        machine.body[:, :3] *= part
        machine.joint[:, VISCOUS] *= part[:, 0]
    bare = machine.copy()
    if tier.rough:
        bind(system, rng, machine)
        bare = machine.copy()
    pool = [name for name in tier.pool if possible(name, system)]
    size = float(np.exp(rng.uniform(*np.log(tier.size))))
    count = seed % (tier.effects + 1) if tier.rough else tier.effects
    chosen, lacking = [], [bare.copy() for _ in range(count)]
    for number, name in enumerate(rng.choice(pool, size=count, replace=False)):
        for other, without in enumerate(lacking):
            if other != number:
                hide(str(name), system, deepcopy(rng), size, without)
        chosen.append(hide(str(name), system, rng, size, machine))
    if not tellable(chosen, system):
        return None
    if tier.outside:
        kinds = [kind for kind in OUTSIDE if not (kind == "coupling" and J == 1)]
        kind = str(rng.choice(kinds))
        j = 0 if kind == "coupling" else int(rng.integers(J))
        machine.joint[j, OUTSIDE[kind]] = rng.uniform(0.15, 0.4) * system.force[j]
        chosen.append({"name": "outside", "kind": kind, "target": system.joints[j]})
        lacking.append(bare)
    velocities, width = bool(rng.integers(2)), float(rng.uniform(1e-3, 4e-3))
    recordings, motions = [], []
    for number in range(RECORDINGS):
        commands = np.stack([excitation(rng, system.limit[u], number) for u in range(U)], axis=1)
        start = np.array([rng.normal(0, 0.1 if k % 2 == 0 else 0.3) for k in range(2 * J)])
        feedback = np.zeros((U, 2 * J))
        if tier.laboratory and number % 2:
            for u, j in enumerate(system.drives):
                feedback[u, 2 * j : 2 * j + 2] = 0.2 * system.limit[u], 0.05 * system.limit[u]
        drives = np.array(system.drives)
        states = simulate(
            system.kind,
            start,
            commands,
            feedback,
            DT,
            machine.body,
            machine.joint,
            machine.actuator,
            drives,
            GRAVITY,
            width,
        )
        if not np.isfinite(states).all() or np.abs(states).max() > 1e3:
            return None
        columns = measure(
            system, states, commands, machine.sensor, velocities, rng, tier.laboratory
        )
        if tier.rough:
            columns = roughened(system, columns, rng)
        recordings.append(columns)
        motions.append((states, commands))
    std, how = np.array([noise_of(system, j) for j in range(J)]), (DT, GRAVITY, width)
    made = Made(system, machine, motions, std, how)
    if not all(map(made.felt, lacking)):
        return None
    besides = (("spring", system.joints[0]), ("dahl_friction", system.joints[0]))
    besides = besides if tier.rough else ()
    told = seed, plant, tuple(chosen), velocities, tuple(recordings), besides
    return Case(*told, made, tuple(lacking))


def nominal(system: System) -> Machine:
    """The plant as the workflow knows it."""
    joint = np.zeros((len(system.joints), NUMBERS))
    joint[:, VISCOUS] = system.viscous
    ideal = [1.0, 0.0, np.inf, 0.0, 0.0, 0.0, 0.0, np.inf]
    actuator = np.tile(ideal, (len(system.inputs), 1))
    return Machine(np.array(system.body), joint, actuator, {})


def possible(name: str, system: System) -> bool:
    """Whether a plant can have an effect, and this simulation knows it there."""
    links = system.kind in (DOUBLE_PENDULUM, ROTARY_PENDULUM)
    return not (
        (name == "body_length" and not links)
        or (name == "gravity_tilt" and system.kind == ROTARY_PENDULUM)
    )


def bind(system: System, rng: np.random.Generator, machine: Machine) -> None:
    """Ties a cable to the first joint: a weak spring, and a force that turns over on the way."""
    reach, part = 1.0 if system.slides[0] else 2.0, rng.uniform(0.005, 0.015)
    machine.joint[0, SPRING] += part * system.force[0] / reach
    machine.joint[0, CABLE] = part * system.force[0]
    machine.joint[0, REACH] = rng.uniform(0.02, 0.1) * reach


def roughened(
    system: System, columns: Mapping[str, np.ndarray], rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """The columns as encoders count them, and without some samples."""
    kept = rng.random(len(columns["time"])) > 0.005
    kept[[0, -1]] = True
    counted = {name: np.asarray(values)[kept] for name, values in columns.items()}
    for j, name in enumerate(system.states[0::2]):
        count = 1.5 * noise_of(system, j)
        counted[name] = count * np.round(counted[name] / count)
    return counted


def noise_of(system: System, joint: int) -> float:
    """Std of the noise of a joint's position, in its unit."""
    return NOISE["m" if system.slides[joint] else "rad"]


def tellable(chosen: Sequence[Mapping[str, Any]], system: System) -> bool:
    """Whether no two effects act as others would, alone or together.

    What the only actuator and a sensor have in delays, all sensors may have in the place of it.
    """
    places = [
        (kind, system.bodies.index(place) if place in system.bodies else system.joints.index(place))
        for effect in chosen
        for kind, names in (("dry", DRY), ("inertial", (*BODY, "armature")))
        if effect["name"] in names
        for place in [effect["target"]]
    ]
    delays = {effect["name"] for effect in chosen} >= {"actuator_delay", "sensor_delay"}
    return len(set(places)) == len(places) and not (delays and len(system.inputs) == 1)


def hide(
    name: str, system: System, rng: np.random.Generator, size: float, machine: Machine
) -> dict[str, Any]:
    """Puts an effect into a machine; says what it is.

    A spring is told together with that of a cable in the same joint, for no motion tells them
    apart, and a delay of an actuator is a whole number of the steps of this simulation.
    """
    body, joint = machine.body, machine.joint
    if name in (*JOINT, "asymmetric_viscous_friction"):
        j, forms = joint_effects(system, rng, size)
        for number, value in forms[name].values():
            joint[j, number] += value
        told = {symbol: float(value) for symbol, (_, value) in forms[name].items()}
        if name == "spring":
            told["k"] = float(joint[j, SPRING])
        return {"name": name, "target": system.joints[j], "parameters": told}
    if name in BODY:
        swinging = [j for j in range(len(system.bodies)) if system.swings[j]]
        j = (
            int(rng.integers(len(system.bodies)))
            if name == "body_mass"
            else int(rng.choice(swinging))
        )
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
            if system.kind == ROTARY_PENDULUM:  # about the hinge alone, which the arm does not turn
                joint[j, ARMATURE] += value
            else:
                body[j, 2] += value
        return {
            "name": name,
            "target": system.bodies[j],
            "parameters": {SYMBOL[name]: float(value)},
        }
    if name in ACTUATOR:
        u = int(rng.integers(len(system.inputs)))
        limit = system.limit[u]
        part = rng.uniform(0.05, 0.15) * size
        value = {
            "actuator_gain": 1.0 + 2 * part * rng.choice([-1, 1]),
            "actuator_dead_zone": part * limit,
            "actuator_saturation": (1.0 - 3 * part) * limit,
            "actuator_delay": STEP * round(rng.uniform(0.01, 0.05) * size / STEP),
            "actuator_lag": rng.uniform(0.01, 0.08) * size,
            "backlash": part * limit,
        }[name]
        machine.actuator[u, ACTUATOR.index(name)] = value
        target = "actuator" if len(system.inputs) == 1 else system.inputs[u]
        return {"name": name, "target": target, "parameters": {SYMBOL[name]: float(value)}}
    if name in MORE:
        return MORE[name](system, rng, machine)
    positions = list(range(0, len(system.states), 2))
    if name == "sensor_offset":  # the zero of a cart's position can be seen by nothing
        positions = [k for k in positions if system.swings[k // 2]]
    k = int(rng.choice(positions))
    value = {
        "sensor_offset": rng.uniform(0.03, 0.1) * size * rng.choice([-1, 1]),
        "sensor_scale": 1.0 + rng.uniform(0.03, 0.1) * size * rng.choice([-1, 1]),
        "sensor_delay": rng.uniform(0.01, 0.05) * size,
    }[name]
    machine.sensor.setdefault(k, {})[name] = float(value)
    return {"name": name, "target": system.states[k], "parameters": {SYMBOL[name]: float(value)}}


def load(system: System, rng: np.random.Generator, machine: Machine) -> dict[str, Any]:
    """Friction of a driven joint that grows with what its actuator does."""
    j, value = int(rng.choice(system.drives)), float(rng.uniform(0.08, 0.25))
    machine.joint[j, LOAD] = value
    return _told("load_dependent_friction", system.joints[j], mu=value)


def lengthen(system: System, rng: np.random.Generator, machine: Machine) -> dict[str, Any]:
    """A longer or shorter first link, where it carries another."""
    value = float(rng.uniform(0.1, 0.3) * rng.choice([-1, 1]) * system.body[0][3])
    machine.body[0, 3] += value
    return _told("body_length", system.bodies[0], l_d=value)


def widen(system: System, rng: np.random.Generator, machine: Machine) -> dict[str, Any]:
    """A dead zone that is wider below 0."""
    u = int(rng.integers(len(system.inputs)))
    up, more = rng.uniform(0.02, 0.06, 2) * system.limit[u] * [1.0, 2.0]
    machine.actuator[u, [1, 6]] = up, more
    return _told("asymmetric_dead_zone", _actuator(system, u), d_p=up, d_n=up + more)


def slow(system: System, rng: np.random.Generator, machine: Machine) -> dict[str, Any]:
    """A force that needs 0.1 to 0.3 s from 0 to its limit."""
    u = int(rng.integers(len(system.inputs)))
    machine.actuator[u, 7] = value = system.limit[u] / rng.uniform(0.1, 0.3)
    return _told("actuator_rate_limit", _actuator(system, u), r=value)


def filter_(system: System, rng: np.random.Generator, machine: Machine) -> dict[str, Any]:
    """A filter behind the sensor of a position."""
    k, value = 2 * int(rng.integers(len(system.joints))), float(rng.uniform(0.01, 0.05))
    machine.sensor[k] = {"sensor_lag": value}
    return _told("sensor_lag", system.states[k], T=value)


def decentre(system: System, rng: np.random.Generator, machine: Machine) -> dict[str, Any]:
    """A disc that is not on its axis."""
    k = 2 * int(rng.choice(np.flatnonzero(~np.array(system.slides))))
    s, c = (float(value) for value in rng.uniform(0.03, 0.08, 2) * rng.choice([-1, 1], 2))
    machine.sensor[k] = {"sine": s, "cosine": c}
    return _told("eccentric_encoder", system.states[k], s=s, c=c)


def tilt(system: System, rng: np.random.Generator, machine: Machine) -> dict[str, Any]:
    """A base that is not level."""
    machine.joint[0, TILT] = value = float(rng.uniform(0.02, 0.08) * rng.choice([-1, 1]))
    return _told("gravity_tilt", system.bodies[0], t=value)


def give_way(system: System, rng: np.random.Generator, machine: Machine) -> dict[str, Any]:
    """Friction of a joint that gives way, like a spring, before it slides."""
    j = int(rng.integers(len(system.joints)))
    f_c = rng.uniform(0.05, 0.15) * system.force[j]
    x_d = rng.uniform(0.003, 0.05) * (1.0 if system.slides[j] else 2.0)
    machine.joint[j, [CABLE, REACH]] = f_c, x_d
    return _told("dahl_friction", system.joints[j], f_c=f_c, x_d=x_d)


def electrify(system: System, rng: np.random.Generator, machine: Machine) -> dict[str, Any]:
    """A motor under a voltage, whose current lags."""
    j = int(rng.choice(system.drives))
    b, lag = rng.uniform(0.1, 0.3) * system.force[j] / system.speed[j], rng.uniform(0.01, 0.05)
    machine.joint[j, [BRAKE, INDUCTANCE]] = b, lag
    return _told("back_emf", system.joints[j], b=b, T=lag)


def loosen(
    system: System, rng: np.random.Generator, machine: Machine, play: bool = False
) -> dict[str, Any]:
    """A motor with an inertia of its own behind a spring, or a stiffer one that has play."""
    j = int(rng.choice(system.drives))
    rotor = rng.uniform(0.1, 0.3) * system.body[j][0 if system.slides[j] else 2]
    rate, ratio = rng.uniform(60.0, 100.0) if play else rng.uniform(15.0, 50.0), 0.2
    gap = play * rng.uniform(0.01, 0.03) * (1.0 if system.slides[j] else 2.0)
    k = rotor * rate**2
    numbers = rotor, k, 2.0 * ratio * rotor * rate, gap
    machine.joint[j, [ROTOR, STIFFNESS, DAMPING, GAP]] = numbers
    values = {"I_m": rotor, "k": k, "z": ratio} | ({"g": gap} if play else {})
    return _told("joint_backlash" if play else "elastic_joint", system.joints[j], **values)


MORE = {
    "load_dependent_friction": load,
    "body_length": lengthen,
    "asymmetric_dead_zone": widen,
    "actuator_rate_limit": slow,
    "sensor_lag": filter_,
    "eccentric_encoder": decentre,
    "gravity_tilt": tilt,
    "dahl_friction": give_way,
    "back_emf": electrify,
    "elastic_joint": loosen,
    "joint_backlash": partial(loosen, play=True),
}


def _told(name: str, target: str, **parameters: float) -> dict[str, Any]:
    numbers = {symbol: float(value) for symbol, value in parameters.items()}
    return {"name": name, "target": target, "parameters": numbers}


def _actuator(system: System, u: int) -> str:
    return "actuator" if len(system.inputs) == 1 else system.inputs[u]


def measure(
    system: System,
    states: np.ndarray,
    commands: np.ndarray,
    sensor: dict[int, dict[str, float]],
    velocities: bool,
    rng: np.random.Generator,
    laboratory: bool,
) -> dict[str, np.ndarray]:
    """The columns of a recording."""
    T = len(states)
    t = DT * np.arange(T)
    stamps = t + rng.uniform(-2e-3, 2e-3, T) * (t > 0) if laboratory else t
    columns = {"time": stamps}
    for k, name in enumerate(system.states):
        if k % 2 and not velocities:
            continue
        hidden = sensor.get(k, {})
        y = seen(states, k, stamps, hidden)
        noise = rng.standard_normal(T)
        if laboratory:  # correlated over two samples, and now and then far off
            noise = lfilter([math.sqrt(1.0 - 0.5**2)], [1.0, -0.5], noise)
            noise += 40.0 * (rng.random(T) < 0.003) * rng.choice([-1, 1], T)
        std = noise_of(system, k // 2) * (10.0 if k % 2 else 1.0)
        columns[name] = y + std * noise
    return columns | {name: commands[:, u] for u, name in enumerate(system.inputs)}


def seen(states: np.ndarray, k: int, t: np.ndarray, hidden: Mapping[str, float]) -> np.ndarray:
    """The readings of state k at times t, without noise."""
    y = at(states, k, np.maximum(t - hidden.get("sensor_delay", 0.0), 0.0))
    if "sensor_lag" in hidden:
        y = behind(states, k, t, hidden["sensor_lag"])
    y = y + hidden.get("sine", 0.0) * np.sin(y) + hidden.get("cosine", 0.0) * np.cos(y)
    return hidden.get("sensor_scale", 1.0) * y + hidden.get("sensor_offset", 0.0)


def at(states: np.ndarray, k: int, t: np.ndarray) -> np.ndarray:
    """State k between the samples."""
    own = DT * np.arange(len(states))
    if np.array_equal(t, own):
        return states[:, k]
    spline = CubicHermiteSpline(own, states[:, k - k % 2], states[:, k - k % 2 + 1])
    return spline.derivative()(t) if k % 2 else spline(t)


def behind(states: np.ndarray, k: int, t: np.ndarray, lag: float) -> np.ndarray:
    """State k behind a filter of first order that starts at rest, at times t."""
    fine = np.arange(0.0, DT * (len(states) - 1) + 1e-9, DT / 40)
    seen = at(states, k, fine)
    _, filtered, _ = lsim(([1.0], [lag, 1.0]), seen, fine, X0=[seen[0] * lag])
    return np.interp(t, fine, filtered)


def excitation(rng: np.random.Generator, limit: float, number: int) -> np.ndarray:
    """Commands: chirp, multisine, steps, or small and slow."""
    T = round(SECONDS / DT)
    t = DT * np.arange(T)
    kind = number % 4
    if kind == 0:
        f0, f1 = rng.uniform(0.1, 0.3), rng.uniform(1.5, 3.0)
        x = np.sin(2 * np.pi * (f0 * t + (f1 - f0) * t**2 / (2 * SECONDS)) + rng.uniform(0, 6))
    elif kind == 1:
        x = (
            sum(np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in rng.uniform(0.2, 2.5, 6))
            / 2.5
        )
    elif kind == 2:
        x = np.repeat(rng.uniform(-1, 1, T), rng.integers(10, 30))[:T]
    else:
        x = (
            0.4 * np.sin(2 * np.pi * rng.uniform(0.2, 0.5) * t)
            + 0.3 * np.repeat(rng.uniform(-1, 1, T), 25)[:T]
        )
    return np.clip(x, -1, 1) * limit * rng.uniform(0.6, 1.0)
