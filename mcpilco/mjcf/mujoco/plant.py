"""MuJoCo itself as a plant: contacts, servos, tendons, loops and free joints included."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import mujoco
import numpy as np
from jaxtyping import Bool, Float, Int
from mujoco.batch import Batch

from mcpilco.mjcf.models import warnings_of_mujoco
from mcpilco.mjcf.mujoco.coordinates import Coordinates, states
from mcpilco.mjcf.mujoco.filters import actuate, observe, push
from mcpilco.mjcf.mujoco.numbers import EditedNumbers
from mcpilco.plant import (
    GAIN,
    IDEAL_ACTUATOR,
    IDEAL_SENSOR,
    RUNAWAY,
    TURN,
    ActuatorGain,
    ActuatorSaturation,
    Axis,
    EffectInstance,
    JointForce,
    Plant,
    RememberingForce,
    Tables,
)
from mcpilco.typing import InputError

MOTIONS = 512
"""simulated at a time, so that what is kept of them fits into memory"""
STEP, PAIR = 2.0, 0.1
"""what a timestep costs of itself, and for each pair of degrees of freedom, in integrator steps of
an equation, each about a microsecond; each of the stages of an integrator costs as much"""
FINER = 3
"""times as short a timestep beside which its error is seen, and by which it is made shorter"""
_DRIVEN = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)

_TIME = int(mujoco.mjtState.mjSTATE_TIME)


@dataclass(frozen=True, eq=False)
class MujocoPlant(Plant):
    """A plant that MuJoCo simulates, with the model's own timestep and integrator.

    Where commands are held for no whole number of timesteps, these are a little shorter. What a
    model can say of an effect is written into it; commands are filtered before they reach it, and
    other forces of joints are held for a timestep. Dry friction is MuJoCo's own.
    """

    model: mujoco.MjModel
    """as it was compiled"""
    built: Mapping[str, float]
    """values of the parameters that it was compiled with"""
    strengths: Float[np.ndarray, " U"]
    """force of each actuator for a unit of its command; 1 where the command is no force"""
    start: Float[np.ndarray, " X"] = field(kw_only=True)
    """the state in which it is where nothing is known of it"""

    @property
    def simulated_by(self) -> str:
        return f"MuJoCo itself, in timesteps of {1e3 * self.model.opt.timestep:g} ms at most"

    def finely(self, times: int) -> MujocoPlant:
        model = copy.copy(self.model)
        model.opt.timestep /= times
        return replace(self, model=model)

    def timesteps(
        self,
        start: Float[np.ndarray, "W X"],
        commands: Float[np.ndarray, "W T_all U"],
        lead: int,
        dt: float,
        every: int,
        measured: Float[np.ndarray, "W X T"],
        std: Float[np.ndarray, " X"],
    ) -> tuple[int, Float[np.ndarray, " X"]]:
        each = np.arange(len(start))

        def states_at(times: int) -> Float[np.ndarray, "W X T"]:
            tables, plant = self.tables(self.nominal[None]), self.finely(times)
            return plant.run(tables, 0 * each, start, each, commands, lead, dt, every=every)

        times, now, then = 1, states_at(1), states_at(FINER)
        while ((error := self._apart(now, then, measured)) > std).any() and times < FINER:
            times *= FINER
            now, then = then, states_at(times * FINER)
        if np.isfinite(error).all():
            return times, error
        raise InputError(
            f"{self.name} must follow the recordings for a second, but simulated by "
            f"{self.finely(times).simulated_by}, it flies apart in most windows; choose a shorter "
            "timestep, softer contacts (solref), or the pose of the recordings (--keyframe)."
        )

    def _apart(
        self,
        now: Float[np.ndarray, "W X T"],
        then: Float[np.ndarray, "W X T"],
        measured: Float[np.ndarray, "W X T"],
    ) -> Float[np.ndarray, " X"]:
        """By how much motions differ in two timesteps, where there is a measurement."""
        apart = self.beside(now, then) - then
        apart[~np.isfinite(apart)] = np.inf
        apart[~np.isfinite(measured)] = 0.0
        return np.sqrt(np.median(np.square(apart).mean(axis=2), axis=0))

    @property
    def timestep_s(self) -> float:
        return float(self.model.opt.timestep)

    @property
    def least_s(self) -> float:
        return self.timestep_s

    @property
    def rest(self) -> Float[np.ndarray, " X"]:
        return self.start

    @property
    def nominal_plant(self) -> MujocoPlant:
        """The same as it was compiled, without effects."""
        return replace(self.where(**self.built), added=(), learned=())

    @cached_property
    def coordinates(self) -> Coordinates:
        """Where its positions are in MuJoCo's."""
        return Coordinates.of(self.model)

    @cached_property
    def _scratch(self) -> EditedNumbers:
        """A model to try on whether it takes an effect."""
        return EditedNumbers(copy.copy(self.model), self.layout)

    def refusal(self, instance: EffectInstance) -> str:
        effect, target = instance.effect, instance.target
        if isinstance(effect, RememberingForce):
            return "MuJoCo keeps no memory of a joint's motion"
        if effect.place == "actuator":
            u = self.layout.actuators.index(target)
            gain, bias = self.model.actuator_gaintype[u], self.model.actuator_biastype[u]
            if isinstance(effect, ActuatorGain) and max(gain, bias) > 1:
                return "its force is no affine function of its command"
            if refused := super().refusal(instance):
                return refused
        if effect.name in ("center_of_mass", "body_inertia"):
            body = self.model.body(target) if target in self._body_names else None
            if body is not None and self.model.body_simple[body.id]:
                return "the model has it as a body whose axes are those of its joint"
        return ""

    @cached_property
    def _body_names(self) -> set[str]:
        return {self.model.body(b).name for b in range(self.model.nbody)}

    def says(self, active: EffectInstance) -> bool:
        """Whether the model itself can say an effect."""
        effect = active.effect
        if isinstance(effect, JointForce):
            if effect.loaded:
                return False
            numbered = enumerate(effect.symbols)
            kinds = [TURN.neutral if s == TURN else 1.0 + 0.7 * i for i, s in numbered]
            return self._scratch.add_force(active.target, lambda q, v: effect.force(q, v, *kinds))
        if effect.place == "actuator":
            return isinstance(effect, ActuatorGain | ActuatorSaturation)
        return effect.place != "sensor"

    def tables(
        self,
        parameters: Float[np.ndarray, "S P"],
        actives: Sequence[EffectInstance] = (),
        values: Sequence[Float[np.ndarray, "S _"]] = (),
        grids: Sequence[tuple[str, tuple[Axis, ...]]] = (),
        weights: Sequence[Float[np.ndarray, "S _"]] = (),
    ) -> Tables:
        S, names = len(parameters), [parameter.name for parameter in self.parameters]
        everything = [a for a, _ in self.added] + [*actives]
        said = [self.says(active) for active in everything]
        forces = [
            (active.effect, active.target)
            for active, by_model in zip(everything, said, strict=True)
            if isinstance(active.effect, JointForce) and not by_model
        ]
        models = [copy.copy(self.model) for _ in range(S)]
        tables = self._blank(models, forces, S, grids, weights)
        tables.actuators[:, :, GAIN] = self.strengths
        rows = iter(range(len(forces)))
        places = [
            None if by_model else self._at(active, rows)
            for active, by_model in zip(everything, said, strict=True)
        ]
        for s, row in enumerate(parameters):
            model = EditedNumbers(models[s], self.layout)
            for name, value in zip(names, row, strict=True):
                if value != self.built[name]:
                    model.set(name, value)
            each = [numbers for _, numbers in self.added] + [value[s] for value in values]
            for active, at, numbers in zip(everything, places, each, strict=True):
                if at is None:
                    active.effect.write_mjcf(model, active.target, tuple(map(float, numbers)))
                else:
                    active.effect.install(tables, s, at, numbers)
            model.finish()
            for u, actuator in enumerate(self.layout.actuators):
                if actuator not in self.layout.servos and self.strengths[u] != 1.0:
                    tables.actuators[s, u, GAIN] = model.gain(actuator) or 1.0
        return tables

    def run(
        self,
        tables: Tables,
        system: Int[np.ndarray, " B"],
        start: Float[np.ndarray, "B X"],
        window: Int[np.ndarray, " B"],
        commands: Float[np.ndarray, "W T_all U"],
        lead: int,
        dt: float,
        taken: Int[np.ndarray, " 1"] | None = None,
        every: int = 1,
        path: Float[np.ndarray, "W lead_plus_1 X"] | None = None,
        accuracy: float = 1.0,
    ) -> Float[np.ndarray, "B X T"]:
        steps = max(1, math.ceil(dt / self.model.opt.timestep - 1e-9))
        exact = abs(dt / steps - self.model.opt.timestep) < 1e-9 * dt
        for model in tables.chains:
            model.opt.timestep = self.model.opt.timestep if exact else dt / steps
        T = (commands.shape[1] - lead) // every
        y = np.full((len(start), start.shape[1], T), np.nan)
        given = commands, np.empty((len(commands), 0, start.shape[1])) if path is None else path
        for first in range(0, len(start), MOTIONS):
            some = slice(first, first + MOTIONS)
            how = _Motions(self, tables, system[some], window[some], *given, lead, dt, steps)
            with warnings_of_mujoco():  # what flies apart is NaN
                y[some] = how.measured(start[some], T, every)
        if taken is not None:
            n = len(start) * (T - 1) * every * steps
            stages = 4 if self.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4 else 1
            taken[0] += round((STEP + PAIR * self.model.nv**2) * stages * n)
        return y

    def beside(
        self, y: Float[np.ndarray, "... X T"], measured: Float[np.ndarray, "... X T"]
    ) -> Float[np.ndarray, "... X T"]:
        return self.coordinates.beside(y, measured) if self.layout.orientations else y

    def mass_matrix(self, q: Float[np.ndarray, "N J"]) -> Float[np.ndarray, "N J J"]:
        def full(data: mujoco.MjData) -> np.ndarray:
            M = np.empty((self.model.nv, self.model.nv))
            mujoco.mj_fullM(self.model, data, M)
            return M

        return np.array([full(data) for data in self._at_states(q)])

    def weights(self, q: Float[np.ndarray, "N J"]) -> Float[np.ndarray, "N J"]:
        return np.array([data.qfrc_bias.copy() for data in self._at_states(q)])

    def actuation(
        self, q: Float[np.ndarray, "N J"], v: Float[np.ndarray, "N J"], u: Float[np.ndarray, "N U"]
    ) -> Float[np.ndarray, "N J"] | None:
        return np.array([d.qfrc_actuator + d.qfrc_constraint for d in self._at_states(q, v, u)])

    def _at_states(self, q, v=None, u=None):
        """MuJoCo's data at some states, one after the other."""
        data = mujoco.MjData(self.model)
        for n, qpos in enumerate(self.coordinates.qpos(q)):
            data.qpos[:] = qpos
            data.qvel[:] = 0.0 if v is None else v[n]
            data.ctrl[:] = 0.0 if u is None else u[n]
            mujoco.mj_forward(self.model, data)
            yield data

    def mass_and_length(self, target: str) -> tuple[float, float]:
        body = self.layout.bodies.index(target) if target in self.layout.bodies else None
        joint = self.layout.joint_of(target)
        if body is None:
            carried = [b for b, j in enumerate(self.layout.carriers) if j >= joint]
            body = carried[0] if carried else len(self.layout.bodies) - 1
        mass, arm = self._scratch.inertials.mass_and_arm(self.layout.bodies[body])
        return mass, float(np.linalg.norm(arm))


@dataclass(frozen=True)
class _Motions:
    """Motions of some systems under commands, each held for `steps` timesteps."""

    plant: MujocoPlant
    tables: Tables
    system: Int[np.ndarray, " B"]
    window: Int[np.ndarray, " B"]
    commands: Float[np.ndarray, "W T_all U"]
    path: Float[np.ndarray, "W lead_plus_1 X"] | Float[np.ndarray, "W 0 X"]
    lead: int
    dt: float
    steps: int

    @property
    def around(self) -> Tables:
        """The tables without the models, for the compiled loops."""
        return self.tables._replace(chains=())

    def measured(
        self, start: Float[np.ndarray, "B X"], T: int, every: int
    ) -> Float[np.ndarray, "B X T"]:
        """The readings of the sensors along the motions, at T samples."""
        n = (T - 1) * every * self.steps
        qpos, qvel, lost = self.followed(start, n)
        at = self.plant.coordinates
        q = np.concatenate([start[:, None, 0::2], at.positions(qpos)], axis=1)
        v = np.concatenate([start[:, None, 1::2], qvel], axis=1)
        if (self.tables.sensors[self.system] == np.array(IDEAL_SENSOR)).all():
            y = states(q, v)[:, :: every * self.steps].transpose(0, 2, 1).copy()
        else:
            y = np.full((*start.shape, T), np.nan)
            known = self.window, np.ascontiguousarray(self.path)
            observe(self.around, self.system, *known, q, v, self.steps, self.dt, every, y)
        gone = np.pad(np.maximum.accumulate(lost, axis=1), ((0, 0), (1, 0)))
        gone |= ~(np.abs(v) < RUNAWAY).all(axis=2)
        y[np.broadcast_to(gone[:, None, :: every * self.steps], y.shape)] = np.nan
        return y

    def followed(
        self, start: Float[np.ndarray, "B X"], n: int
    ) -> tuple[Float[np.ndarray, "B n Q"], Float[np.ndarray, "B n J"], Bool[np.ndarray, "B n"]]:
        """Positions and velocities after each of n timesteps, and where MuJoCo gave up."""
        model, models = self.plant.model, [self.tables.chains[s] for s in self.system]
        batch = Batch(models[0], len(models), 0)
        batch.set_models(models)
        batch.bind("qpos")[:] = self.plant.coordinates.qpos(start[:, 0::2])
        batch.bind("qvel")[:] = start[:, 1::2]
        if model.na:
            batch.bind("act")[:] = self._activations()
        given = self._given(n)
        U = model.nu
        ctrl, pulses = self._into_ctrl(given[:, :, :U]), np.zeros((len(models), n, model.nv))
        for u in range(U, given.shape[2]):  # what is no actuator of the model pushes its joint
            pulses[:, :, self.tables.drives[u]] += given[:, :, u]
        if len(self.tables.law) or len(self.tables.learned.joint):
            return self._pushed(batch, ctrl, pulses, given)
        both = np.concatenate([ctrl, pulses], axis=2)
        seen = batch.rollout(n, both, _DRIVEN, ["qpos", "qvel", _TIME])
        return seen["qpos"], seen["qvel"], self._late(seen[_TIME][..., 0])

    def _late(self, time: Float[np.ndarray, "B n"]) -> Bool[np.ndarray, "B n"]:
        """Where a simulation was stopped or begun anew, for its clock does not go on."""
        due = (np.arange(time.shape[1]) + 0.5) * self.dt / self.steps
        return time < due

    def _pushed(self, batch, ctrl, pulses, given):
        """The same with forces in joints that depend on the motion."""
        B, n, J = pulses.shape
        named = "qpos", "qvel", "time", "ctrl", "qfrc_applied", "qfrc_actuator"
        qpos, qvel, time, now, applied, load = (batch.bind(name) for name in named)
        path, speeds, clock = np.empty((B, n, qpos.shape[1])), np.empty((B, n, J)), np.empty((B, n))
        forces, around = np.empty((B, J)), self.around
        for i in range(n):
            q = self.plant.coordinates.positions(qpos)
            push(around, self.system, q, np.array(qvel), np.array(load), given[:, i], forces)
            now[:], applied[:] = ctrl[:, i], pulses[:, i] + forces
            batch.step()
            path[:, i], speeds[:, i], clock[:, i] = qpos, qvel, np.ravel(time)
        return path, speeds, self._late(clock)

    @property
    def _filtered(self) -> bool:
        """Whether something acts on a command before it reaches the model."""
        others = np.arange(len(IDEAL_ACTUATOR)) != GAIN
        numbers = self.tables.actuators[self.system][:, :, others]
        return not (numbers == np.array(IDEAL_ACTUATOR)[others]).all()

    def _given(self, n: int) -> Float[np.ndarray, "B n U"]:
        """The requests of each input in each timestep: forces, or targets of servos."""
        if not self._filtered:
            gains = self.tables.actuators[self.system, None, :, GAIN]
            step = self.lead + np.arange(n) // self.steps
            return gains * self.commands[self.window[:, None], step]
        model, commands = self.plant.model, self.commands.copy()
        for u in np.flatnonzero(model.actuator_ctrllimited):
            commands[:, :, u] = np.clip(commands[:, :, u], *model.actuator_ctrlrange[u])
        given = np.empty((len(self.system), n, commands.shape[2]))
        actuate(
            self.around, self.system, self.window, commands, self.lead, self.dt, self.steps, given
        )
        return given

    def _into_ctrl(self, given: Float[np.ndarray, "B n U"]) -> Float[np.ndarray, "B n U"]:
        """The commands with which the model's actuators give so much."""
        if not self._filtered:  # as they came, to the last bit
            step = self.lead + np.arange(given.shape[1]) // self.steps
            return self.commands[self.window[:, None], step][:, :, : given.shape[2]]
        return given / self.tables.actuators[self.system, None, : given.shape[2], GAIN]

    def _activations(self) -> Float[np.ndarray, "B A"]:
        """The states of actuators that lag, after the commands before the start."""
        model = self.plant.model
        act = np.zeros((len(self.system), model.na))
        for u in range(model.nu):
            kind, at = int(model.actuator_dyntype[u]), int(model.actuator_actadr[u])
            if at >= 0 and kind != int(mujoco.mjtDyn.mjDYN_INTEGRATOR):
                part = 1.0 - math.exp(-self.dt / max(float(model.actuator_dynprm[u, 0]), 1e-6))
                for k in range(self.lead):
                    act[:, at] += part * (self.commands[self.window, k, u] - act[:, at])
        return act
