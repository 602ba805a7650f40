"""The arm of mujoco.sysid's tutorial: its armatures by both tools.

The model, its truth, its torques and its noise are those of the tutorial's notebook (Google
DeepMind, python/mujoco/sysid/sysid.ipynb, Apache 2.0): five hinges, 2 s at 500 Hz from rest,
positions with noise of 0.6 rad, and a nominal model whose armatures are all 0.01 kg m^2.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import rollout
from scipy.optimize import least_squares

from mcpilco.mjcf import read_plant
from mcpilco.plant import CATALOGUE, EffectInstance, Plant
from mcpilco.sweep import machine

STEP_S, SECONDS = 0.002, 2.0
NOISE_RAD = 0.6
NOMINAL, LARGEST = 0.01, 0.6
"""armature of all joints in the nominal model, and the largest that is tried [kg m^2]"""
TORQUES = (5.0, 4.0, 3.0, 2.0, 1.0)
"""amplitudes of the sines that drive the joints [N m]"""
RATES = (0.5, 0.7, 0.4, 0.9, 0.6)
"""their frequencies [Hz]"""
PHASES = 0.5 * np.arange(5)


@dataclass(frozen=True)
class Link:
    """A body on a hinge."""

    below: float
    """height of its joint above the one before [m]"""
    mass: float
    center: float
    """height of its center of mass above its joint [m]"""
    inertia: tuple[float, float, float]
    axis: tuple[int, int, int]
    damping: float
    armature: float
    """the true one"""


LINKS = (
    Link(0.1, 1.0, 0.05, (0.01, 0.01, 0.005), (0, 0, 1), 1.0, 0.5),
    Link(0.1, 0.8, 0.05, (0.008, 0.008, 0.004), (0, 1, 0), 0.8, 0.4),
    Link(0.1, 0.6, 0.05, (0.006, 0.006, 0.003), (0, 1, 0), 0.6, 0.3),
    Link(0.1, 0.4, 0.04, (0.004, 0.004, 0.002), (0, 0, 1), 0.4, 0.2),
    Link(0.08, 0.2, 0.03, (0.002, 0.002, 0.001), (0, 1, 0), 0.2, 0.1),
)
JOINTS = tuple(f"joint{n}" for n in range(1, 6))
TRUTH = np.array([link.armature for link in LINKS])


def arm(armatures: Sequence[float]) -> mujoco.MjSpec:
    """The arm with some armatures [kg m^2]; a sensor reads each joint's position."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = STEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    body = spec.worldbody
    for n, (joint, link) in enumerate(zip(JOINTS, LINKS, strict=True)):
        body = body.add_body(name=f"link{n + 1}", pos=[0.0, 0.0, link.below])
        body.mass, body.ipos, body.inertia = link.mass, [0.0, 0.0, link.center], link.inertia
        body.explicitinertial = True
        body.add_joint(
            name=joint,
            axis=link.axis,
            range=[-3.14, 3.14],
            damping=link.damping,
            armature=armatures[n],
        )
        motor = spec.add_actuator(name=f"act{n + 1}", target=joint)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.set_to_motor()
        kind, of = mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtObj.mjOBJ_JOINT
        spec.add_sensor(name=f"{joint}_pos", type=kind, objtype=of, objname=joint)
    return spec


def moved(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Stamps (T,), torques (T + 1, 5) and positions (T, 5), as sensors read them beside the stamps.

    MuJoCo reads sensors at the beginning of a timestep: what is stamped t was so a timestep ago.
    """
    t = STEP_S * np.arange(round(SECONDS / STEP_S))
    torques = TORQUES * np.sin(2.0 * np.pi * t[:, None] * RATES + PHASES)
    model = arm(TRUTH).compile()
    data = mujoco.MjData(model)
    states, read = rollout.rollout(model, data, _rest(model), torques[None, :-1])
    rng = np.random.default_rng(seed)
    return states[0, :, 0], torques, read[0] + rng.normal(0.0, NOISE_RAD, read[0].shape)


def _rest(model: mujoco.MjModel) -> np.ndarray:
    return np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))


# Both tools ---------------------------------------------------------------------------------------


def by_sysid(stamps: np.ndarray, torques: np.ndarray, read: np.ndarray) -> np.ndarray:
    """The armatures that mujoco.sysid fits, by its default optimizer [kg m^2]."""
    from mujoco import sysid

    def setter(joint: str) -> Callable[[mujoco.MjSpec, Any], None]:
        return lambda spec, found: setattr(spec.joint(joint), "armature", found.value[0])

    wanted = sysid.ParameterDict()
    for joint in JOINTS:
        bounds = {"nominal": NOMINAL, "min_value": NOMINAL, "max_value": LARGEST}
        wanted.add(sysid.Parameter(joint, modifier=setter(joint), **bounds))
    spec = arm([NOMINAL] * 5)
    model = spec.compile()
    given = sysid.TimeSeries(STEP_S * np.arange(len(torques)), torques)
    measured = sysid.TimeSeries.from_names(stamps, read, model)
    recorded = sysid.ModelSequences("arm", spec, "tutorial", _rest(model), given, measured)
    missed = sysid.build_residual_fn(models_sequences=[recorded])
    found, _ = sysid.optimize(initial_params=wanted, residual_fn=missed, verbose=False)
    return found.as_vector()


def by_equations(plant: Plant, torques: np.ndarray, read: np.ndarray) -> np.ndarray:
    """The same by the plant's equations of motion and scipy's least squares [kg m^2]."""
    effects = [EffectInstance(CATALOGUE["armature"], joint) for joint in JOINTS]
    commands = torques[None, : len(read)]

    def positions(armatures: np.ndarray) -> np.ndarray:
        S = len(armatures)
        tables = plant.tables(np.tile(plant.nominal, (S, 1)), effects, armatures.T[:, :, None])
        start, each = np.zeros((S, len(plant.layout.states))), np.zeros(S, dtype=np.int64)
        y = plant.run(tables, np.arange(S), start, each, commands, 0, STEP_S)
        return y[:, 0::2].transpose(0, 2, 1).reshape(S, -1)

    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def at(armatures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The residuals and their slopes, in one batch of simulations."""
        steps = 1e-3 * np.maximum(armatures, NOMINAL)
        y = positions(armatures + np.vstack([np.zeros(5), np.diag(steps)]))
        return known.setdefault(
            armatures.tobytes(), (y[0] - read.ravel(), ((y[1:] - y[0]) / steps[:, None]).T)
        )

    found = least_squares(
        lambda armatures: at(armatures)[0],
        np.full(5, 1e-3),
        lambda armatures: known[armatures.tobytes()][1],
        bounds=(0.0, LARGEST - NOMINAL),
        x_scale="jac",
        ftol=1e-6,
    )
    return NOMINAL + found.x


# What is kept -------------------------------------------------------------------------------------


def nominal() -> Plant:
    """The plant that is read of the nominal model."""
    spec = arm([NOMINAL] * 5)
    spec.compile()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.xml"
        path.write_text(spec.to_xml(), encoding="utf-8")
        return read_plant(path)


def fitted(seed: int) -> dict[str, Any]:
    """Armatures by both tools of one recording, and the CPU time of each, on one core."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    plant, (stamps, torques, read) = nominal(), moved(seed)
    tools: dict[str, Callable[[], np.ndarray]] = {
        "sysid": lambda: by_sysid(stamps, torques, read),
        "equations": lambda: by_equations(plant, torques, read),
    }
    found: dict[str, Any] = {"seed": seed, "place": machine()}
    for tool, fit in tools.items():
        fit()  # compiles, and loads what is loaded once
        begun = time.process_time()
        armatures = fit()
        found[tool] = {"armatures": armatures.tolist(), "cpu_s": time.process_time() - begun}
    return found
