"""Learned forces in MuJoCo: what MJCF cannot say, as a callback."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from mcpilco.plant.effects.learned import LearnedForce
from mcpilco.typing import InputError


def passive_forces(
    model: mujoco.MjModel, forces: Sequence[LearnedForce]
) -> Callable[[mujoco.MjModel, mujoco.MjData], None]:
    """A callback that adds learned forces to `data.qfrc_passive`, at every stage of a step.

    MuJoCo calls it after `mujoco.set_mjcb_passive(callback)`, for all models of the process; those
    with other names are not for it. `mujoco.set_mjcb_passive(None)` takes it away.

    Args:
        model: whose joints are pushed; its motors have constant gains.
        forces: learned on a plant of this model, `Correction.learned`.

    Raises:
        InputError: a force at a joint, or over a state or input, that the model does not have.
    """
    joints = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
    inputs = [model.actuator(u).name or f"actuator{u}" for u in range(model.nu)]
    states = [f"{joint}_{what}" for joint in joints for what in ("position", "velocity")]
    for force in forces:
        unknown = {force.joint} - {*joints} or {a.of for a in force.axes} - {*states, *inputs}
        if unknown:
            raise InputError(
                f"the model has no joint, state or input {unknown.pop()!r}; it has "
                f"{', '.join((*joints, *states, *inputs))}."
            )

    def value(data: mujoco.MjData, name: str) -> float:
        if name in inputs:
            return _drive(model, data, inputs.index(name))
        j = states.index(name) // 2
        if name.endswith("_position"):
            return float(data.qpos[model.jnt_qposadr[j]])
        return float(data.qvel[model.jnt_dofadr[j]])

    def push(called: mujoco.MjModel, data: mujoco.MjData) -> None:
        for force in forces:
            at = (np.array([value(data, axis.of)]) for axis in force.axes)
            data.qfrc_passive[model.jnt_dofadr[joints.index(force.joint)]] += force.at(*at)[0]

    return push


def _drive(model: mujoco.MjModel, data: mujoco.MjData, u: int) -> float:
    """Force of a motor at its joint, of its command now."""
    command = float(data.ctrl[u])
    if model.actuator_ctrllimited[u]:
        command = float(np.clip(command, *model.actuator_ctrlrange[u]))
    force = float(model.actuator_gainprm[u, 0]) * command
    if model.actuator_forcelimited[u]:
        force = float(np.clip(force, *model.actuator_forcerange[u]))
    return float(model.actuator_gear[u, 0]) * force
