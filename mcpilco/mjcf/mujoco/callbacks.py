"""The part of a plant that MJCF cannot say, in plain MuJoCo: as a callback, a module, in steps."""

from __future__ import annotations

import math
import pprint
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from jaxtyping import Float

from mcpilco.files import write_bytes
from mcpilco.mjcf.models import warnings_of_mujoco
from mcpilco.mjcf.mujoco.coordinates import states
from mcpilco.mjcf.mujoco.filters import push, step_force
from mcpilco.mjcf.mujoco.plant import MujocoPlant
from mcpilco.mjcf.mujoco.read import mujoco_plant
from mcpilco.plant import (
    DELAY,
    GAIN,
    Correction,
    corrected,
    correction_from,
    correction_json,
    correction_of,
)

MODULE = '''"""What {name}.xml cannot say: `install(model)` lets MuJoCo's control callback add it.

    model = mujoco.MjModel.from_xml_path("{name}.xml")
    {name}.install(model)
"""

from mcpilco.mjcf import install_correction

CORRECTION = {content}


def install(model):
    """Add it to every step of this model; mujoco.set_mjcb_control(None) takes it away."""
    return install_correction(model, CORRECTION)
'''


def write_callbacks(path: Path, plant: MujocoPlant) -> list[str]:
    """Writes a module for what MJCF cannot say of a plant, if there is anything.

    Returns:
        A sentence on each effect that is in it, and on each that is to be applied elsewhere.
    """
    beside = [(active, values) for active, values in plant.added if not plant.says(active)]
    sensors = [active for active, _ in beside if active.effect.place == "sensor"]
    told = [f"{active}; apply it to what is measured." for active in sensors]
    acting = [(active, values) for active, values in beside if active not in sensors]
    if not acting and not plant.learned:
        path.unlink(missing_ok=True)
        return told
    bare = plant.nominal_plant
    content = correction_json(correction_of(bare.having(acting).with_learned(plant.learned), bare))
    text = MODULE.format(
        name=path.stem, content=pprint.pformat(content, width=96, sort_dicts=False)
    )
    write_bytes(path, text.encode())
    named = [*(active for active, _ in acting), *plant.learned]
    return [*(f"{each}; {path.name} adds it: {path.stem}.install(model)." for each in named), *told]


def install_correction(
    model: mujoco.MjModel, content: Correction | Mapping[str, Any]
) -> StepCallback:
    """Lets MuJoCo's control callback add to a model what MJCF cannot say of a correction.

    MuJoCo has one such callback for all models of a process; other models are left alone. While it
    is there, `mujoco.batch` and `mujoco.rollout` refuse to run.

    Raises:
        InputError: the correction does not fit the model.
    """
    correction = content if isinstance(content, Correction) else correction_from(dict(content))
    plant = corrected(mujoco_plant(model, correction.plant), correction)
    assert isinstance(plant, MujocoPlant)
    callback = StepCallback(model, plant)
    mujoco.set_mjcb_control(callback)
    return callback


class StepCallback:
    """Filters commands and pushes joints, once a timestep; stages of an integrator keep both.

    It tells the command that a user has set from the one that it has written itself.
    """

    def __init__(self, model: mujoco.MjModel, plant: MujocoPlant) -> None:
        self._model, self._plant = model, plant
        self._tables = plant.tables(plant.nominal[None])._replace(chains=())
        actuators = self._tables.actuators[0]
        past = int(actuators[:, DELAY].max(initial=0.0) // model.opt.timestep) + 2
        self._room = np.zeros((past, model.nu)), np.zeros((model.nu, 2))
        self._before: tuple[np.ndarray, np.ndarray] | None = None
        self._after = self._room
        self._clock = -np.inf
        self._stages = 0
        self._ctrl = _Given(model.nu)
        self._applied = _Given(model.nv)

    def command(self, data: mujoco.MjData, command: Float[np.ndarray, " U"]) -> None:
        """Sets the commands of a user, whatever was written over the last ones."""
        self._ctrl = _Given(len(command))
        data.ctrl[:] = command

    def begin(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Begins a motion before which every command was 0."""
        self._clock = -np.inf
        self.command(data, np.zeros(model.nu))
        self(model, data)
        self._before = self._after

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Called by MuJoCo."""
        if model.names != self._model.names:
            return
        h, begun = model.opt.timestep, self._clock == -np.inf or data.time < self._clock
        if begun:
            self._ctrl, self._applied = _Given(model.nu), _Given(model.nv)
        elif self._in_a_stage(model, data.time - self._clock, h):
            return
        command = self._ctrl.by_user(data.ctrl)
        held = command.copy()
        for u in np.flatnonzero(model.actuator_ctrllimited):
            held[u] = np.clip(held[u], *model.actuator_ctrlrange[u])
        if begun or data.time > self._clock + 0.5 * h:
            self._before = None if begun else self._after
            self._clock, self._stages = data.time, 0
        forces, actuated = (part.copy() for part in self._before or self._room)
        given = np.empty(model.nu)
        first = self._before is None
        step_force(self._tables, held, h, forces, actuated, first, given)
        self._after = forces, actuated
        self._ctrl.write(data.ctrl, command, given / self._tables.actuators[0, : model.nu, GAIN])
        q = self._plant.coordinates.positions(np.array(data.qpos))[None]
        pushes = np.zeros((1, model.nv))
        load, v = (np.array(part)[None] for part in (data.qfrc_actuator, data.qvel))
        push(self._tables, np.zeros(1, np.int64), q, v, load, given[None], pushes)
        own = self._applied.by_user(data.qfrc_applied)
        self._applied.write(data.qfrc_applied, own, own + pushes[0])

    def _in_a_stage(self, model: mujoco.MjModel, since: float, h: float) -> bool:
        """Whether this is a later stage of the step; the last one's time is that of the next."""
        if model.opt.integrator != mujoco.mjtIntegrator.mjINT_RK4 or since < 0.25 * h:
            return False
        self._stages += 1
        return since < 0.75 * h or self._stages == 3


class SteppedModel:
    """A model with the effects of its plant, which MuJoCo steps from command to command."""

    def __init__(self, plant: MujocoPlant, dt: float) -> None:
        """In the state 0, of commands that are held for dt [s]."""
        self._plant = plant
        self._model = plant.tables(plant.nominal[None]).chains[0]
        self._steps = max(1, math.ceil(dt / self._model.opt.timestep - 1e-9))
        self._model.opt.timestep = dt / self._steps
        self._data = mujoco.MjData(self._model)
        self._added = StepCallback(self._model, plant)
        self.restart(np.zeros(2 * self._model.nv))

    @property
    def state(self) -> Float[np.ndarray, " X"]:
        """Positions and velocities now."""
        q = self._plant.coordinates.positions(np.array(self._data.qpos))
        return states(q, np.array(self._data.qvel))

    def restart(self, state: Float[np.ndarray, " X"]) -> None:
        """Begins anew in a state; no command came before."""
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = self._plant.coordinates.qpos(state[0::2])
        self._data.qvel[:] = state[1::2]
        self._added.begin(self._model, self._data)

    def advance(self, command: Float[np.ndarray, " U"]) -> Float[np.ndarray, " X"]:
        """Holds a command for dt: the state at its end, NaN where MuJoCo gives up."""
        self._added.command(self._data, command)
        due = self._data.time + self._steps * self._model.opt.timestep
        with warnings_of_mujoco():
            for _ in range(self._steps):
                self._added(self._model, self._data)
                mujoco.mj_step(self._model, self._data)
        late = abs(self._data.time - due) > 0.5 * self._model.opt.timestep
        return np.full_like(self.state, np.nan) if late else self.state


class _Given:
    """Numbers of MuJoCo's data that a user sets, and that are replaced by others."""

    def __init__(self, size: int) -> None:
        self._user, self._written = np.zeros(size), np.full(size, np.nan)

    def by_user(self, now: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The commands that the user has set last."""
        return np.where(now == self._written, self._user, now)

    def write(self, into: Float[np.ndarray, " n"], user: np.ndarray, numbers: np.ndarray) -> None:
        """Replaces what the user has set."""
        self._user, self._written = user.copy(), numbers.copy()
        into[:] = numbers
