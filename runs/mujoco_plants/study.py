"""A blind study: a seed hides an effect in a machine that others modelled, the workflow looks.

The workflow sees the recordings and the nominal model. The truth is a plain loop of mj_step with a
quarter of the model's timestep (truth.py), its sensors are noisy and count in steps.
"""

from __future__ import annotations

import itertools
import logging
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from truth import FINER, HELD_S, MACHINES, OTHERS, Effects, Machine, drive, machines_of

from mcpilco.gap import Gap, investigate
from mcpilco.mjcf import MujocoPlant, mujoco_plant, plant_of_model
from mcpilco.plant import Plant
from mcpilco.recordings import Recording
from mcpilco.sweep import machine
from mcpilco.typing import InputError

RECORDINGS, SECONDS = 5, 5.0
NOISE = (1e-3, 2e-2)
"""std of the noise of positions and velocities [m or rad, m/s or rad/s]"""
COUNT = 2.0 * math.pi / 4096
"""step in which a position is read [m or rad]"""
FELT = 30.0
"""noise std by which an effect must move all windows together, else another one is drawn"""
WINDOW = 53
"""samples over which it is to be felt"""
EMPTY = 5
"""one in so many seeds hides nothing"""
AGAIN = 1_000_000
"""from one seed to the next that is drawn in its place"""
SURE = 0.9
"""probability above which a name is meant"""


@dataclass(frozen=True)
class Hidden:
    """What a seed hid in a machine."""

    seed: int
    machine: str
    effect: str = ""
    target: str = ""
    value: float = 0.0
    """of its size, in its unit"""


@dataclass(frozen=True)
class Motion:
    """A machine in motion."""

    states: np.ndarray
    """(T + 1, X), of its sensors without noise"""
    qpos: np.ndarray
    qvel: np.ndarray
    commands: np.ndarray
    """(T, U)"""


def drawn(seed: int) -> tuple[Hidden, Plant, list[Recording]]:
    """What a seed hides, the nominal plant, and recordings; drawn anew where it is not felt."""
    machines = machines_of(seed)
    name = list(machines)[seed % len(machines)]
    this, nominal = machines[name], machines[name].model()
    plant = mujoco_plant(nominal, name.replace(" ", "_"))
    seen = plant_of_model(nominal, Path(plant.name)) if this.equations else plant
    for anew in itertools.count():
        rng = np.random.default_rng(seed + AGAIN * anew)
        fine = this.model()
        fine.opt.timestep /= FINER
        before = _motions(this, plant, fine, Effects(), seed)
        if seed // len(machines) % EMPTY == EMPTY - 1:
            return Hidden(seed, name), seen, _recorded(plant, before, rng)
        usual = _usual(plant, before)
        effect, target, value, read = _hide(plant, this, rng, fine, effects := Effects(), usual)
        mujoco.mj_setConst(fine, mujoco.MjData(fine))
        try:
            motions = _motions(this, plant, fine, effects, seed)
        except InputError:
            continue  # it falls to pieces
        read = [Motion(read(m.states), m.qpos, m.qvel, m.commands) for m in motions]
        if _felt(plant, read) > FELT:
            hidden = Hidden(seed, name, effect, target, value)
            return hidden, seen, _recorded(plant, read, rng)
    raise AssertionError


def _motions(
    this: Machine, plant: MujocoPlant, model: mujoco.MjModel, effects: Effects, seed: int
) -> list[Motion]:
    found = []
    for n in range(RECORDINGS):
        rng = np.random.default_rng([seed, n])
        qpos, qvel, u = drive(this, plant.model, model, effects, rng, SECONDS)
        if not (np.isfinite(qpos).all() and np.abs(qvel).max() < 100.0):
            raise InputError("it runs away.")
        q = plant.coordinates.positions(qpos)
        states = np.stack([q, qvel], axis=2).reshape(len(q), -1)
        found.append(Motion(states, qpos, qvel, u))
    return found


# What is hidden -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Usual:
    """What is usual at a degree of freedom, by which effects are sized."""

    force: np.ndarray
    speed: np.ndarray
    reach: np.ndarray
    inertia: np.ndarray


def _usual(plant: MujocoPlant, motions: Sequence[Motion]) -> _Usual:
    """The forces of actuators, the speeds, ways and inertias, rms over some motions."""
    data, M = mujoco.MjData(plant.model), np.empty((plant.model.nv, plant.model.nv))
    forces, inertias = [], []
    for m in motions:
        for k in range(0, len(m.commands), 10):
            data.qpos[:], data.qvel[:], data.ctrl[:] = m.qpos[k], m.qvel[k], m.commands[k]
            mujoco.mj_forward(plant.model, data)
            mujoco.mj_fullM(plant.model, data, M)
            forces.append(data.qfrc_actuator.copy())
            inertias.append(np.diag(M).copy())
    v = np.concatenate([m.qvel for m in motions])
    q = np.concatenate([m.states[:, 0::2] for m in motions])
    rms = [np.sqrt(np.mean(np.square(part), axis=0)) for part in (forces, v)]
    return _Usual(rms[0], rms[1], 0.5 * np.ptp(q, axis=0), np.mean(inertias, axis=0))


def _hide(
    plant: MujocoPlant,
    this: Machine,
    rng: np.random.Generator,
    model: mujoco.MjModel,
    effects: Effects,
    usual: _Usual,
) -> tuple[str, str, float, Callable[[np.ndarray], np.ndarray]]:
    """Hides one effect in a model, its commands, forces or readings; how its states are read."""
    layout, size = plant.layout, rng.uniform(0.05, 0.15)
    u = int(rng.integers(model.nu))
    j = layout.drives[u]
    joint, actuator = layout.joints[j], layout.actuators[u]
    force, speed, reach = usual.force[j], usual.speed[j], usual.reach[j]
    b = int(model.jnt_bodyid[model.dof_jntid[j]])
    x = 2 * j
    sign = float(rng.choice([-1, 1]))

    def as_it_is(y: np.ndarray) -> np.ndarray:
        return y

    pool = [
        *("viscous_friction", "coulomb_friction", "quadratic_drag", "spring", "constant_force"),
        *("armature", "body_mass", "actuator_gain", "actuator_delay", "actuator_lag"),
        *("sensor_offset", "sensor_delay"),
    ]
    if not this.servos:
        pool.append("actuator_dead_zone")
    if not this.pose:
        pool += ["contact_friction", "ground_height"] * 2
    effect = str(rng.choice(pool))
    target, value = joint, 0.0
    if effect == "viscous_friction":
        model.dof_damping[j] += (value := 2.0 * size * force / speed)
    elif effect == "coulomb_friction":
        model.dof_frictionloss[j] += (value := 2.0 * size * force)
    elif effect == "quadratic_drag":
        effects.drag[j] = value = 2.0 * size * force / speed**2
    elif effect == "spring":
        effects.spring[j] = value = 2.0 * size * force / reach
    elif effect == "constant_force":
        effects.push[j] = value = 2.0 * sign * size * force
    elif effect == "armature":
        model.dof_armature[j] += (value := 3.0 * size * usual.inertia[j])
    elif effect == "body_mass":
        target, value = model.body(b).name, 3.0 * size * model.body_mass[b]
        model.body_inertia[b] *= 1.0 + value / model.body_mass[b]
        model.body_mass[b] += value
    elif effect == "actuator_gain":
        target, value = actuator, 1.0 + 2.0 * sign * size
        model.actuator_gainprm[u, :3] *= value
        model.actuator_biasprm[u, :3] *= value
    elif effect == "actuator_delay":
        h = model.opt.timestep
        target, value = actuator, h * round(rng.uniform(0.01, 0.05) / h)
        effects.delay_s[u] = value
    elif effect == "actuator_lag":
        target, value = actuator, rng.uniform(0.01, 0.05)
        effects.lag_s[u] = value
    elif effect == "actuator_dead_zone":
        command = np.abs(force / max(abs(plant.strengths[u]), 1e-12))
        target, value = actuator, 2.0 * size * command * abs(plant.strengths[u])
        effects.dead[u] = 2.0 * size * command
    elif effect == "sensor_offset":
        target, value = layout.states[x], sign * rng.uniform(0.01, 0.04)
        return effect, target, value, lambda y: y + value * np.eye(y.shape[1])[x]
    elif effect == "sensor_delay":
        target, late = layout.states[x], int(rng.integers(1, 3))
        return effect, target, late * HELD_S, lambda y: _late(y, x, late)
    elif effect == "contact_friction":
        target, value = "ground", float(np.exp(sign * rng.uniform(0.4, 0.8)))
        model.geom_friction[:, 0] *= value
        model.pair_friction[:, :2] *= value
    else:
        target, value = "ground", sign * rng.uniform(0.005, 0.02)
        model.geom_pos[model.geom_bodyid == 0, 2] += value
    return effect, target, float(value), as_it_is


def _late(y: np.ndarray, x: int, samples: int) -> np.ndarray:
    y = y.copy()
    y[samples:, x] = y[:-samples, x]
    return y


def _felt(plant: MujocoPlant, motions: Sequence[Motion]) -> float:
    """By how many noise std all windows together differ from the nominal model's motions."""
    total, exact = 0.0, plant.finely(FINER)
    for m in motions:
        starts = np.arange(20, len(m.commands) - WINDOW, WINDOW)
        commands = np.stack([m.commands[s : s + WINDOW] for s in starts])
        y = exact.simulate(m.states[starts], commands, HELD_S)
        real = np.stack([m.states[s : s + WINDOW + 1] for s in starts])
        apart = plant.beside(y.transpose(0, 2, 1), real.transpose(0, 2, 1)) - real.transpose(
            0, 2, 1
        )
        total += float(np.nansum(np.square(apart[:, 0::2] / NOISE[0])))
    return math.sqrt(total)


def _recorded(
    plant: MujocoPlant, motions: Sequence[Motion], rng: np.random.Generator
) -> list[Recording]:
    layout, found = plant.layout, []
    for n, m in enumerate(motions):
        y = m.states + rng.normal(0.0, 1.0, m.states.shape) * np.tile(NOISE, len(layout.joints))
        y[:, 0::2] = COUNT * np.round(y[:, 0::2] / COUNT)
        found.append(
            Recording(
                f"run{n}",
                HELD_S * np.arange(len(y)),
                y,
                np.concatenate([m.commands, m.commands[-1:]]),
                layout.states,
                layout.inputs,
                angles=plant.angles,
                velocities=tuple((k, k + 1) for k in range(0, y.shape[1], 2)),
            )
        )
    return found


# What is found ------------------------------------------------------------------------------------


def tried(seed: int) -> dict[str, Any]:
    """What an investigation finds in the case of a seed."""
    hidden, plant, recordings = drawn(seed)
    stages: dict[str, float] = {}
    begun = time.perf_counter(), time.process_time()

    class Told(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            stages[record.getMessage()] = round(time.process_time() - begun[1], 1)

    logger, told = logging.getLogger("mcpilco.gap"), Told()
    logger.addHandler(told)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    try:
        answer = _answer(investigate(plant, recordings))
    except InputError as error:  # the recordings look wrong to it
        answer = {"verdict": "refused", "found": [], "closest": [], "said": str(error)}
    finally:
        logger.removeHandler(told)
    return {
        "seed": seed,
        "machine": hidden.machine,
        "truth": [hidden.effect, hidden.target, hidden.value],
        **answer,
        "stages_cpu_s": stages,
        "wall_s": time.perf_counter() - begun[0],
        "cpu_s": time.process_time() - begun[1],
        "place": machine(),
    }


def _answer(gap: Gap) -> dict[str, Any]:
    """The verdict of an investigation, its effects, and what they leave over."""
    shown = gap.named or (gap.closest.effects if gap.closest else ())
    return {
        "verdict": gap.verdict,
        "found": [_told(each) for each in gap.named],
        "closest": [] if gap.named else [_told(each) for each in shown],
        "left": {f.joint: f.usual for f in gap.left},
        "closed": gap.comparison.closed.value if gap.comparison else None,
    }


def _told(each: Any) -> dict[str, Any]:
    values = {k: v.value for k, v in each.parameters.items()}
    known = {"name": each.name, "target": each.target, "family": list(each.family)}
    return known | {"probability": each.probability, "values": values}


def judged(result: Mapping[str, Any]) -> str:
    """Right, in the family, wrong (and sure), or nothing named where something was hidden."""
    name, target, _ = result["truth"]
    found = [(each["name"], each["target"]) for each in result["found"]]
    if not name:
        return "right" if result["verdict"] == "none" else _wrong(result)
    if found == [(name, target)] and result["verdict"] == "named":
        return "right"
    if len(found) == 1 and name in result["found"][0]["family"]:
        return "in the family"
    if (name, target) in found:
        return "right, and more"
    return _wrong(result)


def _wrong(result: Mapping[str, Any]) -> str:
    if not result["found"]:
        return result["verdict"]
    return "wrong, sure" if surely_wrong(result) else "wrong"


def surely_wrong(result: Mapping[str, Any]) -> bool:
    """Whether a name is meant that is not there, nor in a family with what is."""
    name, target, _ = result["truth"]
    sure = [each for each in result["found"] if each["probability"] > SURE]
    there = [(each["name"], each["target"]) == (name, target) for each in sure]
    return not all(right or name in each["family"] for right, each in zip(there, sure, strict=True))


def summary(results: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Rows: machine, cases, named rightly or in the family, nothing hidden, wrong and sure."""
    rows = []
    for name in (*MACHINES, *OTHERS, "all"):
        own = [r for r in results if name in (r["machine"], "all")]
        if not own:
            continue
        with_, without = ([r for r in own if bool(r["truth"][0]) is some] for some in (True, False))
        good = sum(judged(r) in ("right", "in the family") for r in with_)
        quiet = sum(judged(r) == "right" for r in without)
        sure = sum(map(surely_wrong, own))
        minutes = np.array([r["cpu_s"] for r in own]) / 60.0
        rows.append(
            (
                name,
                str(len(own)),
                *(f"{k} of {n}" for k, n in ((good, len(with_)), (quiet, len(without)))),
                f"{sure} of {len(own)}",
                f"{np.median(minutes):.1f} ({minutes.max():.1f})",
            )
        )
    return rows
