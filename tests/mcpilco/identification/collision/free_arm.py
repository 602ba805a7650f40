"""What the tests share: a simulated arm, samples of it, and a small model of its currents."""

from __future__ import annotations

import functools

import mujoco
import numpy as np

from envs.arms.motions import waypoints
from envs.arms.sticky_arm import MODEL, SAMPLING_S, ArmLog, Push, StickyArm
from mcpilco.identification import Report, RigidBody
from mcpilco.identification.collision import (
    CURRENT_TERMS,
    CurrentConfig,
    CurrentModel,
    fit_currents,
)
from mcpilco.recordings import ArmSamples, arm_samples

SMALL = {"points": 400, "fit_points": 120, "iterations": 15}
DT = SAMPLING_S


@functools.cache
def arm() -> StickyArm:
    return StickyArm.drawn(np.random.default_rng(0))


@functools.cache
def body() -> RigidBody:
    return RigidBody.of(mujoco.MjModel.from_xml_path(str(MODEL)), terms=CURRENT_TERMS)


@functools.cache
def log(seed: int, moves: int = 20, pushes: tuple[Push, ...] = ()) -> ArmLog:
    rng = np.random.default_rng(seed)
    return arm().follow(waypoints(moves, rng), rng, pushes)


@functools.cache
def samples(seed: int, moves: int = 20, pushes: tuple[Push, ...] = ()) -> ArmSamples:
    return arm_samples(log(seed, moves, pushes))


@functools.cache
def fitted(kind: str = "FC", gate: str = "hard") -> tuple[CurrentModel, Report]:
    config = CurrentConfig(kind=kind, gate=gate, **SMALL)
    return fit_currents(samples(1, 30), body(), DT, config)
