"""Pushes in the recordings of an arm: what its collision detector is worth to `mcpilco gap`.

python runs/touched_arm/run.py --quick               # does it run at all?
python runs/touched_arm/run.py                       # seeds 5000:5008
python runs/touched_arm/run.py --seeds 5000:5002

Results are kept in results/, a file a seed; the same command goes on where it was stopped, and
rewrites README.md between its marked lines from all results that are there.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import fill, folder, kept, once, parse_seeds, places, use_one_thread

import envs
from envs.arms.motions import Sinusoids, random_sinusoids
from mcpilco.gap import Gap, investigate
from mcpilco.identification import RigidBody
from mcpilco.identification.collision import (
    CURRENT_TERMS,
    CurrentConfig,
    detect,
    events,
    fit_currents,
    thresholds,
)
from mcpilco.logbook import versions
from mcpilco.mjcf import mjcf_of_plant
from mcpilco.plant import ChainPlant
from mcpilco.recordings import ArmRecording, ArmSamples, Recording, arm_samples
from mcpilco.sweep import machine, markdown, spread, spread_cell

HERE = Path(__file__).parent
PLANT = "mcpilco/DoublePendulum-v0"
"""two links in the vertical plane; here with a motor in each joint"""
DT, STEP = 0.01, 5e-4
"""between two samples of the log, and of the simulation that makes it [s]"""
STIFFNESS, DAMPING = (20.0, 8.0), (1.0, 0.3)
"""of the controller of each joint [N m/rad, N m s/rad]; it knows no forces"""
PER_CURRENT = 0.5
"""torque of the motors [N m/A]"""
NOISE = {"position": 5e-4, "velocity": 5e-3, "current": 0.01}
"""of the sensors [rad, rad/s, A]"""
TOUCHED, FREE, SECONDS = 6, (6, 6), 10.0
"""recordings in which the arm is pushed; those without contact to learn from and to set thresholds
by; of so many seconds each"""
PUSHES = 2
"""in a recording"""
MARGIN = 0.05
"""before an alarm and after the last one of an event that is left out as well [s]: the detector
waits for three samples"""
RECORDED = ("never touched", "as it was recorded", "without the detector's events", "by the truth")
"""the recordings that an investigation sees"""

Span = tuple[float, float]


@dataclass(frozen=True)
class Hidden:
    """The effect that a seed hides in the arm."""

    name: str
    target: str
    symbol: str
    """of the parameter"""
    value: float
    """in its unit"""


@dataclass(frozen=True)
class Arguments:
    """Hide an effect, push the arm, investigate, and write the table."""

    seeds: str = "5000:5008"
    """`5000:5008` are 5000 to 5007"""
    quick: bool = False
    """one seed, few data; the table goes to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    out = folder(HERE, arguments.out, arguments.quick)
    for seed in parse_seeds(arguments.seeds)[: 1 if arguments.quick else None]:
        path = out / "results" / f"{seed:04d}.json"
        once(path, HERE.name, investigated, seed, arguments.quick)
        write_readme(out)
    print(f"Table: {out / 'README.md'}")
    return 0


def investigated(seed: int, quick: bool = False) -> dict[str, Any]:
    """The names found in each kind of recordings of a seed's arm, beside the truth, as JSON."""
    rng = np.random.default_rng(seed)
    plant = envs.PLANTS[PLANT]()
    arm, hidden = drawn(plant, rng)
    learn, check = ([recorded(arm, rng)[0] for _ in range(n)] for n in FREE)
    motions = [random_sinusoids(arm, rng) for _ in range(3 if quick else TOUCHED)]
    untouched = [recorded(arm, rng, motion)[0] for motion in motions]
    pushed = [recorded(arm, rng, motion, drawn_pushes(rng)) for motion in motions]
    logs = [log for log, _ in pushed]
    found = detected(plant, learn, check, logs)
    truth = [[(start, start + lasting) for start, lasting, _ in pushes] for _, pushes in pushed]
    seen: dict[str, list[Recording]] = {
        "never touched": [of_plant(plant, log, k) for k, log in enumerate(untouched)],
        "as it was recorded": [of_plant(plant, log, k) for k, log in enumerate(logs)],
        "without the detector's events": masked(plant, logs, found),
        "by the truth": masked(plant, logs, truth),
    }
    results = {}
    for name in RECORDED[1:2] if quick else RECORDED:
        begun = time.process_time()
        gap = investigate(plant, seen[name], accepted=())
        results[name] = told(gap, hidden) | {"cpu_s": time.process_time() - begun}
        print(f"seed {seed}, {name}: {gap.verdict} {results[name]['names']}", flush=True)
    return {
        "seed": seed,
        "hidden": vars(hidden),
        "pushes": [sum(inside(span, found[k]) for span in truth[k]) for k in range(len(truth))],
        "alarms": [sum(not inside(span, truth[k]) for span in found[k]) for k in range(len(truth))],
        "masked_s": sum(b - a for spans in found for a, b in spans),
        "results": results,
        "machine": machine(),
        "versions": versions(),
    }


# The arm ------------------------------------------------------------------------------------------


def drawn(plant: ChainPlant, rng: np.random.Generator) -> tuple[mujoco.MjModel, Hidden]:
    """An arm in which one effect is hidden, and which."""
    arm = mujoco.MjModel.from_xml_string(mjcf_of_plant(plant))
    arm.opt.timestep, arm.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    arm.dof_damping[:] = [plant.values[f"{joint}_friction"] for joint in plant.layout.joints]
    arm.jnt_range[:] = -1.5, 1.5
    kind, j = rng.choice(["payload", "viscous", "coulomb", "gain"]), int(rng.integers(2))
    joint = plant.layout.joints[j]
    if kind == "payload":
        factor = 1.0 + rng.uniform(0.2, 0.5)
        arm.body_mass[2] *= factor
        arm.body_inertia[2] *= factor
        hidden = Hidden("body_mass", "lower", "m_d", (factor - 1.0) * plant.values["lower_mass"])
    elif kind == "viscous":
        value = rng.uniform(0.03, 0.1)
        arm.dof_damping[j] += value
        hidden = Hidden("viscous_friction", joint, "b", value)
    elif kind == "coulomb":
        value = arm.dof_frictionloss[j] = rng.uniform(0.05, 0.2)
        hidden = Hidden("coulomb_friction", joint, "f_c", value)
    else:
        value = arm.actuator_gainprm[j, 0] = rng.uniform(0.7, 0.9)
        hidden = Hidden("actuator_gain", plant.layout.inputs[j], "k", value)
    mujoco.mj_setConst(arm, mujoco.MjData(arm))
    return arm, hidden


Push = tuple[float, float, float]
"""begin [s], duration [s], torque about the shoulder [N m]"""


def drawn_pushes(rng: np.random.Generator) -> list[Push]:
    """Pushes across the arm, in parts of the recording of their own."""
    parts, sides = np.linspace(0.5, SECONDS - 0.5, PUSHES + 1), rng.choice([-1.0, 1.0], PUSHES)
    return [
        (rng.uniform(a, b - 1.0), rng.uniform(0.3, 0.8), side * rng.uniform(0.5, 2.5))
        for (a, b), side in zip(pairwise(parts), sides, strict=True)
    ]


def recorded(
    arm: mujoco.MjModel,
    rng: np.random.Generator,
    motion: Sinusoids | None = None,
    pushes: Sequence[Push] = (),
) -> tuple[ArmRecording, Sequence[Push]]:
    """The log of the arm while its controller follows a motion, and the pushes in it."""
    time_s, data = np.arange(0.0, SECONDS, DT), mujoco.MjData(arm)
    q, dq, _ = (motion or random_sinusoids(arm, rng)).at(time_s)
    data.qpos[:], rows = q[0], []
    jacobian, tip = np.zeros((3, arm.nv)), np.array([0.0, 0.0, -0.3])
    for want, speed in zip(q, dq, strict=True):
        seen = data.qpos + NOISE["position"] * rng.normal(size=arm.nv)
        moved = data.qvel + NOISE["velocity"] * rng.normal(size=arm.nv)
        torque = STIFFNESS * (want - seen) + DAMPING * (speed - moved)
        rows.append((seen, moved, torque))
        data.ctrl[:] = torque
        for _ in range(round(DT / STEP)):
            data.qfrc_applied[:] = 0.0
            for start, lasting, size in pushes:
                if start <= data.time < start + lasting:
                    at = data.xpos[2] + data.xmat[2].reshape(3, 3) @ tip
                    mujoco.mj_jac(arm, data, jacobian, None, at, 2)
                    across = jacobian[:, 0] / max(float(jacobian[:, 0] @ jacobian[:, 0]), 0.02)
                    data.qfrc_applied[:] += jacobian.T @ (size * across)
            mujoco.mj_step(arm, data)
    seen, moved, torque = (np.array(column) for column in zip(*rows, strict=True))
    current = torque / PER_CURRENT + NOISE["current"] * rng.normal(size=torque.shape)
    log = ArmRecording("arm", time_s, seen, moved, current, q, dq, torque / PER_CURRENT)
    return log, pushes


def of_plant(plant: ChainPlant, log: ArmRecording, number: int) -> Recording:
    """A log as a recording of the plant: what was measured, and the torques that were asked for."""
    states = np.stack([log.position, log.velocity], 2).reshape(len(log.time), -1)
    return Recording(
        name=f"recording_{number}",
        time=log.time,
        states=states,
        inputs=PER_CURRENT * log.target_current,
        state_names=plant.layout.states,
        input_names=plant.layout.inputs,
        angles=plant.angles,
        velocities=((0, 1), (2, 3)),
    )


def masked(
    plant: ChainPlant, logs: Sequence[ArmRecording], spans: Sequence[Sequence[Span]]
) -> list[Recording]:
    """The recordings of logs without what lies in spans of time [s]."""
    rows = zip(logs, spans, strict=True)
    return [of_plant(plant, log, k).without(tuple(inside)) for k, (log, inside) in enumerate(rows)]


# The detector -------------------------------------------------------------------------------------


def detected(
    plant: ChainPlant,
    learn: Sequence[ArmRecording],
    check: Sequence[ArmRecording],
    logs: Sequence[ArmRecording],
) -> list[list[Span]]:
    """The events of each log, with a margin, by a detector that knows the kinematics alone [s]."""
    model = mujoco.MjModel.from_xml_string(mjcf_of_plant(plant))
    body = RigidBody.of(model, terms=CURRENT_TERMS)
    train, held = (ArmSamples.joined([arm_samples(log) for log in some]) for some in (learn, check))
    currents, _ = fit_currents(train, body, DT, CurrentConfig("PP", points=1000))
    limits = thresholds(currents, held)
    return [
        [
            (event.start_s - MARGIN, event.end_s + MARGIN)
            for event in events(detect(currents, limits, arm_samples(log)), currents.joints)
        ]
        for log in logs
    ]


def inside(span: Span, others: Sequence[Span]) -> bool:
    """Whether a span meets one of the others."""
    return any(a < span[1] and span[0] < b for a, b in others)


# The verdict --------------------------------------------------------------------------------------


def told(gap: Gap, hidden: Hidden) -> dict[str, Any]:
    """An investigation beside the truth, as JSON."""
    names = [[effect.name, effect.target] for effect in gap.named]
    right = [hidden.name, hidden.target] in names
    error = covered = None
    for effect in gap.named:
        if right and (effect.name, effect.target) == (hidden.name, hidden.target):
            estimate = effect.parameters[hidden.symbol]
            size = abs(hidden.value - (hidden.name == "actuator_gain"))
            error = abs(estimate.value - hidden.value) / size
            covered = estimate.low <= hidden.value <= estimate.high
    return {
        "verdict": gap.verdict,
        "names": names,
        "right": right and len(names) == 1,
        "named": right,
        "error": error,
        "covered": covered,
        "events": len(gap.events),
    }


# The table ----------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the table of the results that are there into README.md."""
    found = kept(out / "results")
    parts = ["Not measured yet."]
    if found:
        pushes = sum(sum(seed["pushes"]) for seed in found)
        many = sum(PUSHES * len(seed["pushes"]) for seed in found)
        alarms = sum(sum(seed["alarms"]) for seed in found)
        detector = f"The detector found {pushes} of {many} pushes, and {alarms} that were none."
        parts = [table(found), detector, places(found, ", one thread")]
    fill(out / "README.md", parts, template=HERE / "README.md")


def table(found: Sequence[Mapping[str, Any]]) -> str:
    """How often the hidden effect is named: a row for each kind of recordings."""
    header = ["recordings", "seeds", "named alone", "named, others too", "other names or none"]
    header += ["error of its size [%]", "interval holds it", "CPU [s]"]
    lines = []
    for name in RECORDED:
        if rows := [seed["results"][name] for seed in found if name in seed["results"]]:
            alone, named = (sum(row[key] for row in rows) for key in ("right", "named"))
            errors = [100 * row["error"] for row in rows if row["error"] is not None]
            held = sum(bool(row["covered"]) for row in rows)
            counts = [len(rows), alone, named - alone, len(rows) - named]
            line = [name, *map(str, counts), spread_cell(spread(errors), 2) if errors else ""]
            line += [f"{held} of {named}", spread_cell(spread([row["cpu_s"] for row in rows]), 0)]
            lines.append(line)
    return markdown(header, lines)


if __name__ == "__main__":
    sys.exit(main())
