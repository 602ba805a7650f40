"""Machines that others modelled, with an effect, as a plain loop of mj_step moves them.

Nothing here is the workflow's: effects are numbers of the model, forces at a step's beginning, and
commands that come late. The timestep is a quarter of the model's.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

HELD_S = 0.02
"""for which a command is held, and between two samples [s]"""
FINER = 4
"""timesteps of a machine, in one of the model's"""
SERVO_HZ, SERVO_DAMPING = 4.0, 1.0
"""of an arm's position servos: frequency [Hz] and damping ratio [-], each joint by itself"""
REACH_RAD, SINES = 0.45, 3
"""amplitude of an arm's targets about its pose [rad], and sines of which each is a sum"""


@dataclass(frozen=True)
class Machine:
    """A model that a package ships, and how it is driven."""

    package: str
    file: str
    """in the package"""
    pose: tuple[float, ...] = ()
    """of an arm, whose joints follow sines about it; empty: random commands from where it stands"""
    servos: bool = False
    """whether position servos take the places of its motors"""
    part: float = 0.3
    """of the ranges of random commands"""
    equations: bool = False
    """whether the workflow compares it by its equations of motion, for it moves in free air"""
    coupled: bool = False
    """whether the controller of its motors knows that joints move one another, and their damping"""

    @property
    def path(self) -> Path:
        """Of its file."""
        found = importlib.util.find_spec(self.package)
        assert found is not None
        assert found.submodule_search_locations
        return Path(found.submodule_search_locations[0]) / self.file

    def model(self) -> mujoco.MjModel:
        """As it is shipped; where it has servos, with these."""
        spec = mujoco.MjSpec.from_file(str(self.path))
        if self.pose:
            spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        model = spec.compile()
        if not self.servos:
            return model
        inertias = _inertias(model, np.array(self.pose))
        for actuator, inertia in zip(spec.actuators, inertias, strict=True):
            rate = 2.0 * math.pi * SERVO_HZ
            kp, kv = inertia * rate**2, 2.0 * SERVO_DAMPING * inertia * rate
            actuator.set_to_position(kp=kp, kv=kv)
            limit = float(actuator.ctrlrange[1])
            actuator.ctrllimited, actuator.ctrlrange = 0, np.zeros(2)
            actuator.forcelimited, actuator.forcerange = 1, np.array([-limit, limit])
        return spec.compile()


PANDA = ("robosuite", "models/assets/robots/panda/robot.xml", (0.0, 0.3, 0.0, -1.8, 0.0, 2.1, 0.8))
UR5E = ("robosuite", "models/assets/robots/ur5e/robot.xml", (0.0, -1.3, 1.5, -1.7, -1.5, 0.0))
MACHINES = {
    "half_cheetah": Machine("gymnasium", "envs/mujoco/assets/half_cheetah.xml"),
    "walker": Machine("dm_control", "suite/walker.xml"),
    "quadruped": Machine("dm_control", "suite/quadruped.xml"),
    "panda on servos": Machine(*PANDA, servos=True, equations=True),
    "panda on motors": Machine(*PANDA, equations=True),
    "ur5e on servos": Machine(*UR5E, servos=True, equations=True),
    "ur5e on motors": Machine(*UR5E, equations=True),
}
POSES = {
    "iiwa": (0.0, 0.65, 0.0, -1.5, 0.0, 0.6, 0.0),
    "kinova3": (0.0, 0.65, 0.0, 1.89, 0.0, 0.6, -1.57),
    "sawyer": (0.0, -1.18, 0.0, 2.18, 0.0, 0.57, -1.57),
    "spot_arm": (0.0, -1.5, 1.5, 0.0, 0.6, 0.0),
}
"""of further arms of robosuite, on which nothing was developed [rad]"""
OTHERS = {
    f"{arm} on {kind}": Machine(
        "robosuite",
        f"models/assets/robots/{arm}/robot.xml",
        pose,
        servos=kind == "servos",
        equations=True,
        coupled=True,
    )
    for arm, pose in POSES.items()
    for kind in ("servos", "motors")
}
OTHERS_FROM = 5000
"""seed of the study from which on the machines are these"""


def machines_of(seed: int) -> Mapping[str, Machine]:
    """Those from which a seed of the study chooses."""
    return OTHERS if seed >= OTHERS_FROM else MACHINES


def _inertias(model: mujoco.MjModel, pose: np.ndarray) -> np.ndarray:
    """Of the joints that the actuators move, at a pose [kg m^2]."""
    data, M = mujoco.MjData(model), np.empty((model.nv, model.nv))
    data.qpos[:] = pose
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, M)
    return np.diag(M)[model.jnt_dofadr[model.actuator_trnid[:, 0]]]


@dataclass
class Effects:
    """What is hidden in a machine."""

    delay_s: Mapping[int, float] = field(default_factory=dict)
    """of actuators"""
    lag_s: Mapping[int, float] = field(default_factory=dict)
    """their time constants"""
    dead: Mapping[int, float] = field(default_factory=dict)
    """their zones, in units of the command"""
    spring: Mapping[int, float] = field(default_factory=dict)
    """of degrees of freedom [N m/rad]"""
    push: Mapping[int, float] = field(default_factory=dict)
    """constant forces in them [N m]"""
    drag: Mapping[int, float] = field(default_factory=dict)
    """of the square of their speeds [N m s^2/rad^2]"""


def drive(
    machine: Machine,
    nominal: mujoco.MjModel,
    model: mujoco.MjModel,
    effects: Effects,
    rng: np.random.Generator,
    seconds: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (T + 1, Q), velocities (T + 1, V) and commands (T, U) of a machine in motion."""
    T = round(seconds / HELD_S)
    command = (
        _follower(machine, nominal, rng) if machine.pose else _random(machine, nominal, rng, T)
    )
    data = mujoco.MjData(model)
    if machine.pose:
        data.qpos[:] = machine.pose
    h, steps = model.opt.timestep, round(HELD_S / model.opt.timestep)
    assert abs(h * steps - HELD_S) < 1e-9
    sent: list[np.ndarray] = []
    lagging: dict[int, float] = {}
    qpos, qvel = [data.qpos.copy()], [data.qvel.copy()]
    for k in range(T):
        sent.append(command(k, data))
        for i in range(steps):
            data.ctrl[:] = _arriving(sent, k * steps + i, steps, h, effects, lagging)
            for j in {*effects.spring, *effects.push, *effects.drag}:
                q, v = data.qpos[nominal.jnt_qposadr[nominal.dof_jntid[j]]], data.qvel[j]
                force = effects.push.get(j, 0.0) - effects.spring.get(j, 0.0) * q
                data.qfrc_applied[j] = force - effects.drag.get(j, 0.0) * abs(v) * v
            mujoco.mj_step(model, data)
        qpos.append(data.qpos.copy())
        qvel.append(data.qvel.copy())
    return np.array(qpos), np.array(qvel), np.array(sent)


def _arriving(sent, step, steps, h, effects, lagging):
    """The commands that act in a timestep."""
    now = sent[-1].copy()
    for u, delay in effects.delay_s.items():
        late = max(step - round(delay / h), 0) // steps
        now[u] = sent[late][u]
    for u, dead in effects.dead.items():
        now[u] = math.copysign(max(abs(now[u]) - dead, 0.0), now[u])
    for u, lag in effects.lag_s.items():
        before = lagging.get(u, now[u])
        goal, left = now[u], math.exp(-h / lag)
        now[u] = goal + (before - goal) * (1.0 - left) * lag / h  # the mean over the timestep
        lagging[u] = goal + (before - goal) * left
    return now


def _random(machine, nominal, rng, T):
    """Commands within a part of their ranges, held for a tenth of a second."""
    limited = nominal.actuator_ctrllimited.astype(bool)[:, None]
    low, high = np.where(limited, nominal.actuator_ctrlrange, [-1.0, 1.0]).T
    levels = rng.uniform(-machine.part, machine.part, (-(-T // 5), nominal.nu))
    u = 0.5 * (low + high) + 0.5 * (high - low) * np.repeat(levels, 5, axis=0)
    return lambda k, data: u[k]


def _follower(machine, nominal, rng):
    """Targets of servos along sines, or the torques of a controller that follows these."""
    J = nominal.nv
    rates = 2.0 * math.pi * rng.uniform(0.15, 0.9, (SINES, J))
    sizes = rng.dirichlet(np.ones(SINES), J).T * REACH_RAD
    phases = rng.uniform(0.0, 2.0 * math.pi, (SINES, J))
    data, inertias = mujoco.MjData(nominal), np.diag(_inertias(nominal, np.array(machine.pose)))
    damping = machine.coupled * nominal.dof_damping
    rate = 2.0 * math.pi * 1.5  # of the controller, which acts at every sample

    def command(k, measured):
        t = k * HELD_S
        fade = min(t, 1.0)  # from rest
        goal = machine.pose + fade * (sizes * np.sin(rates * t + phases)).sum(axis=0)
        if machine.servos:
            return goal
        speed = fade * (sizes * rates * np.cos(rates * t + phases)).sum(axis=0)
        data.qpos[:], data.qvel[:] = measured.qpos, measured.qvel
        mujoco.mj_forward(nominal, data)
        pull = rate**2 * (goal - measured.qpos) + 1.4 * rate * (speed - measured.qvel)
        low, high = nominal.actuator_ctrlrange.T
        if machine.coupled:
            mujoco.mj_fullM(nominal, data, inertias)
        return np.clip(data.qfrc_bias + damping * speed + inertias @ pull, low, high)

    return command
