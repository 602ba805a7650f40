"""One sampling interval of a plant as a program: from state and command to the next state.

The plant's numbers that depend on its parameters are inputs of the program beside state and
command, so that each particle may have parameters of its own. Between two jumps of a command the
classical Runge-Kutta method takes equal steps; a lag is an exponential. Dry friction turns over no
faster than these steps can follow (`followable`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from jaxtyping import Float

from mcpilco.plant.arithmetic import Real, Tape, larger, smaller
from mcpilco.plant.effects.actuator import ActuatorLag, ActuatorSaturation, shaping
from mcpilco.plant.effects.joint import DryFriction
from mcpilco.plant.equations import chain as chains
from mcpilco.plant.equations.chain import PolynomialForces
from mcpilco.plant.equations.program import Program
from mcpilco.plant.plant import Plant
from mcpilco.plant.simulation.laws import force_of
from mcpilco.plant.simulation.layout import DELAY, LAG, OFFSET, SCALE, Tables
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

FORGOTTEN = 0.05
"""share of a lagging force that commands may have which are no longer remembered [-]"""
PERTURBATION = 0.1
"""relative change of a parameter that shows what depends on it"""

QUICKEST = 1e-3
"""part of a step that a lag takes at least, or is left of a delay's, where particles differ [-]"""
STABLE = 2.0
"""damping rate times step that a Runge-Kutta step bears well; it leaps beyond 2.8 [-]"""
POSES = 16
"""that show how little inertia a joint can have"""

_shaped = shaping()
_CHAIN = ("origin", "mass", "center", "inertia", "armature", "gravity")
_SHARED = ("parent", "slides", "axis", "rotation")
_FIELDS = (*_CHAIN, "constants", "actuators", "sensors")


@dataclass(frozen=True)
class Slot:
    """A number of a plant that depends on its parameters."""

    field: str
    """of `mcpilco.plant.simulation.Tables` or its chains"""
    index: tuple[int, ...]
    """in it, behind the system"""


@dataclass(frozen=True, eq=False)
class PlantStep:
    """The next state of a plant, as a program of [state, command, slots, weights]."""

    program: Program
    """results are the next state, remembered commands included"""
    slots: tuple[Slot, ...]
    """its last inputs, but for the weights of forces that the plant's equations lack"""


def free_parameters(plant: Plant) -> tuple[int, ...]:
    """Which parameters are not exactly known, and have a size that they may differ by."""
    return tuple(i for i, p in enumerate(plant.parameters) if p.uncertain and p.value != 0.0)


def numbers_of(
    plant: Plant, slots: Sequence[Slot], parameters: Float[np.ndarray, "S P"]
) -> Float[np.ndarray, "S K"]:
    """The values of a program's slots, for values of the plant's parameters."""
    tables = plant.tables(np.asarray(parameters, dtype=float))
    rows = slice(None)
    at: list[tuple[Any, ...]] = [(rows, *slot.index) for slot in slots]
    columns = [_field(tables, slot.field)[i] for slot, i in zip(slots, at, strict=True)]
    return np.stack(columns, 1) if columns else np.zeros((len(parameters), 0))


def step_of(
    plant: Plant,
    task: TaskSpec,
    longest: float,
    memory: int = 0,
    missing: PolynomialForces | None = None,
    drawn: Float[np.ndarray, "S P"] | None = None,
) -> PlantStep:
    """The program of one sampling interval.

    Args:
        plant: with the states and inputs of the task, whatever their order.
        task: names states and inputs; its `dt` is the interval.
        longest: a step of the Runge-Kutta method takes [s].
        memory: how many past commands the state holds, behind the plant's own, newest first.
        missing: forces that the plant's equations lack; their weights are given behind the slots.
        drawn: parameters of further plants that the program must do for. A delay is at least as
            many whole steps as that of the plant, and less than one step more.

    Raises:
        InputError: names differ, or the plant has what such a program cannot say.
    """
    tables = plant.tables(plant.nominal[None])
    require_expressible(plant, task, tables, memory)
    further = np.empty((0, len(plant.nominal))) if drawn is None else drawn
    slots = _slots(plant, further)
    X, U = len(task.state_names), len(task.input_names)
    width = X + memory * U + U
    behind = width + len(slots)
    tape = Tape(behind + (missing.count if missing else 0))
    system = system_of(tables, dict(zip(slots, tape.inputs[width:behind], strict=True)))
    if missing:
        system.missing = partial(missing, weights=tape.inputs[behind:])
        system.most = missing.most
    if len(further):  # steps must follow the largest of the frictions
        constants = plant.tables(further).constants
        tables.constants[0] = np.abs(np.concatenate([tables.constants, constants])).max(0)
    followable(system_of(tables, {}), system, min(longest, task.dt))
    state, commands = tape.inputs[:X], commands_of(tape.inputs[X:width], U, memory)
    following = _advance(system, order_of(plant, task), state, commands, task.dt, longest)
    remembered = [command for past in commands[:memory] for command in past]
    return PlantStep(Program.of(tape, [*following, *remembered]), slots)


def require_expressible(plant: Plant, task: TaskSpec, tables: Tables, memory: int) -> None:
    """Raises InputError where a plant does not fit a task, or a step needs what is not known."""
    layout = plant.layout
    if set(layout.states) != set(task.state_names) or set(layout.inputs) != set(task.input_names):
        raise InputError(
            f"The plant {plant.name} must have the states {', '.join(task.state_names)} and the "
            f"inputs {', '.join(task.input_names)} of the task, it has "
            f"{', '.join(layout.states)} and {', '.join(layout.inputs)}; name another plant."
        )
    left = beyond_equations(plant)
    if left:
        raise InputError(
            f"The equations of {plant.name} as a model's mean cannot have {', '.join(left)}; "
            "leave them out of the correction, the Gaussian processes will learn the rest."
        )
    actuators = tables.actuators[0]
    needed = max((past_inputs(a[DELAY], a[LAG], task.dt) for a in actuators), default=0)
    if needed > memory:
        raise InputError(
            f"The actuator of {plant.name} answers to the last {needed} commands beside the "
            f"present one; set model.memory to {needed} (on the command line --memory {needed}), "
            f"got {memory}."
        )


def beyond_equations(plant: Plant) -> tuple[str, ...]:
    """Names of the effects of a plant that its equations as a model's mean cannot have."""
    instances = [(base.active, base.values) for base in plant.base] + [*plant.added]
    acting = [a.effect for a, values in instances if tuple(values) != tuple(a.effect.neutral)]
    names = [effect.name for effect in acting if not effect.in_equations()]
    return tuple(names + ["learned forces"] * bool(plant.learned))


def past_inputs(delay: float, lag: float, dt: float) -> int:
    """The number of past commands that an actuator still answers to, beside the present one.

    The command before the last n acted until n dt - delay before now. Of a lagging force it leaves
    the share exp(-(n dt - delay) / lag), which may be `FORGOTTEN`; without a lag it must be over.

    Delay and lag are the actuator's, dt is the time for which a command is held [s].
    """
    whole, part = _whole_steps(delay, dt)
    late = delay - math.log(FORGOTTEN) * lag
    return max(whole + (part > 0.0), math.ceil(late / dt - 1e-9))


def _whole_steps(delay: float, dt: float) -> tuple[int, float]:
    """A delay as whole steps, and the rest [s]."""
    whole = math.floor(delay / dt + 1e-9)
    rest = delay - whole * dt
    return whole, rest if rest > 1e-9 * dt else 0.0


def _field(tables: Tables, name: str) -> np.ndarray:
    return getattr(tables.chains if name in _CHAIN else tables, name)


def _slots(plant: Plant, further: Float[np.ndarray, "S P"]) -> tuple[Slot, ...]:
    """The numbers that change with an uncertain parameter, or from one further plant to another."""
    free = free_parameters(plant)
    rows = np.tile(plant.nominal, (1 + len(free), 1))
    for row, i in enumerate(free, 1):
        rows[row, i] *= 1.0 + PERTURBATION
    tables = plant.tables(np.concatenate([rows, further]))
    slots = []
    for name in _FIELDS:
        values = _field(tables, name)
        changed = (values != values[:1]).any(0)
        slots += [Slot(name, tuple(map(int, index))) for index in np.argwhere(changed)]
    return tuple(slots)


def system_of(tables: Tables, given: dict[Slot, Real]) -> SimpleNamespace:
    """The first system of some tables, with numbers of a tape in its slots."""
    arrays: dict[str, Any] = {name: getattr(tables.chains, name).tolist() for name in _SHARED}
    for name in _FIELDS:
        array = _field(tables, name)[0].astype(object)
        for slot, number in given.items():
            if slot.field == name:
                array[slot.index] = number
        arrays[name] = array.tolist()
    laws = [
        (effect, joint, constants[: len(effect.symbols)])
        for effect, joint, constants in zip(
            map(force_of, tables.law), tables.joint.tolist(), arrays["constants"], strict=True
        )
    ]
    return SimpleNamespace(
        **arrays,
        laws=laws,
        drives=tables.drives.tolist(),
        expected=tables.actuators[0].tolist(),
        missing=None,
    )


def order_of(plant: Plant, task: TaskSpec) -> tuple[list[int], list[int]]:
    """Where the plant's states and inputs are among those of the task."""
    states = [task.state_names.index(name) for name in plant.layout.states]
    return states, [task.input_names.index(name) for name in plant.layout.inputs]


def commands_of(inputs: Sequence[Real], U: int, memory: int) -> list[list[Real]]:
    """The commands of now, one step ago, ...: of inputs [past, newest first, then now]."""
    now = list(inputs[memory * U :])
    return [now, *(list(inputs[k * U : (k + 1) * U]) for k in range(memory))]


def true_state(system: Any, order: Any, state: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    """Positions and velocities, of measured states in the order of the task."""
    true = [
        (state[i] - sensor[OFFSET]) / sensor[SCALE]
        for i, sensor in zip(order[0], system.sensors, strict=True)
    ]
    return true[0::2], true[1::2]


def _advance(
    system: Any, order: Any, state: Sequence[Real], commands: Any, dt: float, longest: float
) -> list[Any]:
    """The measured state at the end of an interval."""
    q, v = true_state(system, order, state)
    tracks = [
        segments(system, u, [now[order[1][u]] for now in commands], dt)
        for u in range(len(system.drives))
    ]
    jumps = {segment.expected: segment for track in tracks for segment in track}
    begun: Real = 0.0
    expected = 0.0
    for until, jump in sorted(jumps.items()):
        acting = [next(s for s in track if until <= s.expected) for track in tracks]
        varied = not all(isinstance(end, float) for end in (begun, jump.until))
        steps = math.ceil((until - expected) / longest - 1e-9) + varied
        end = larger(jump.until, begun) if varied else jump.until
        h = (end - begun) / steps
        for n in range(steps):
            q, v = _runge_kutta(system, q, v, acting, begun + n * h, h)
        begun, expected = end, until
    following: list[Any] = [0.0] * len(state)
    true = [x for pair in zip(q, v, strict=True) for x in pair]
    for i, x, sensor in zip(order[0], true, system.sensors, strict=True):
        following[i] = sensor[OFFSET] + sensor[SCALE] * x
    return following


@dataclass(frozen=True)
class _Segment:
    """The force of an actuator between two jumps: constant, or on its way to a value."""

    since: Real
    until: Real
    expected: float
    """its end [s]: `until` itself, but where the delay is a number of a tape"""
    at_first: Real
    goal: Real
    lag: Real

    def force_at(self, time: Real) -> Real:
        """The force [N or N m] at a time within it [s]."""
        if self.lag == 0.0:
            return self.goal
        return ActuatorLag.shape(self.at_first, self.goal, time - self.since, self.lag)


def segments(system: Any, u: int, commands: Sequence[Real], dt: float) -> list[_Segment]:
    """The force of an actuator in the interval, by the commands of now, one step ago, ..."""
    actuator, expected = system.actuators[u], system.expected[u]
    goals = [_shaped(actuator, command, 0.0) for command in commands]
    lag, delay = actuator[LAG], actuator[DELAY]
    whole, part = _whole_steps(expected[DELAY], dt)
    until: Real = part
    if not isinstance(delay, float):  # a particle's own, within the same step
        if part == 0.0 and whole:  # at the end of the step before
            whole, part = whole - 1, (1.0 - QUICKEST) * dt
        until = smaller(larger(delay - whole * dt, 0.0), dt)
    if not isinstance(lag, float):
        lag = larger(lag, QUICKEST * dt)
    force, oldest = goals[-1], len(goals) - 1  # the oldest that is known was held for ever
    if lag != 0.0:
        for k in range(oldest - 1, whole, -1):
            acted = dt - until if k == whole + 1 else dt
            force = ActuatorLag.shape(force, goals[k], acted, lag)
    track = []
    if part > 0.0:
        track.append(_Segment(0.0, until, part, force, goals[whole + 1], lag))
        force = track[-1].force_at(until)
    return [*track, _Segment(until, dt, dt, force, goals[whole], lag)]


def _runge_kutta(
    system: Any, q: list[Any], v: list[Any], acting: Sequence[_Segment], time: Real, h: Real
) -> tuple[list[Any], list[Any]]:
    """One step of the classical method of fourth order; a segment acts for each actuator."""

    def slope(q: list[Any], v: list[Any], at: Real) -> list[Any]:
        return accelerations(system, q, v, [segment.force_at(at) for segment in acting])

    def moved(x: list[Any], dx: list[Any], by: Real) -> list[Any]:
        return [a + by * b for a, b in zip(x, dx, strict=True)]

    v1, a1 = v, slope(q, v, time)
    v2 = moved(v, a1, h / 2)
    a2 = slope(moved(q, v1, h / 2), v2, time + h / 2)
    v3 = moved(v, a2, h / 2)
    a3 = slope(moved(q, v2, h / 2), v3, time + h / 2)
    v4 = moved(v, a3, h)
    a4 = slope(moved(q, v3, h), v4, time + h)

    def mean(*slopes: list[Any]) -> list[Any]:
        return [a + 2.0 * (b + c) + d for a, b, c, d in zip(*slopes, strict=True)]

    return moved(q, mean(v1, v2, v3, v4), h / 6), moved(v, mean(a1, a2, a3, a4), h / 6)


def accelerations(system: Any, q: list[Any], v: list[Any], forces: Sequence[Real]) -> list[Any]:
    """q'' under the forces of the actuators, those in the joints, and those that are missing."""
    tau: list[Any] = [0.0] * len(q)
    for drive, force in zip(system.drives, forces, strict=True):
        tau[drive] = force + tau[drive]
    for effect, j, constants in system.laws:
        tau[j] = effect.force(q[j], v[j], *constants) + tau[j]
    if system.missing is None:
        return chains.accelerations(system, q, v, tau)
    R, s = system.missing(q, v)
    left = [t - x for t, x in zip(tau, s, strict=True)]
    found = chains.accelerations_with(system, q, v, left, R)
    return [ActuatorSaturation.shape(a, m) for a, m in zip(found, system.most, strict=True)]


def followable(known: SimpleNamespace, system: Any, step: float) -> None:
    """Slows the turnover of a system's dry friction to what its steps can follow, in place.

    Dry friction turns over within millimetres a second: at rest it damps a joint hundreds of times
    a second. An explicit step that is longer than that leaps over rest, and its derivatives grow
    from step to step, so that a policy learns nothing from them.

    The friction of a joint that turns over within w [m/s or rad/s] damps it by f / (w m) a second
    near rest, where m is the joint's inertia. `w` is raised to where this is `STABLE` a step;
    steps that are short enough leave it.

    The system is `known` in plain numbers, at its nominal parameters; of `system`, numbers of a
    tape, the constants of its laws are changed. `step` is the longest of the integration [s].
    """
    friction = np.zeros(len(known.origin))
    for effect, joint, constants in known.laws:
        if isinstance(effect, DryFriction):
            friction[joint] += sum(abs(constants[i]) for i in effect.forces)
    if not friction.any():
        return
    slowest = friction * most_mobile(known) * step / STABLE
    for effect, joint, constants in system.laws:
        if isinstance(effect, DryFriction):
            turn = effect.turn
            constants[turn] = max(float(constants[turn]), float(slowest[joint]))


def most_mobile(known: SimpleNamespace) -> Float[np.ndarray, " J"]:
    """Most acceleration at a joint for a unit force there, over some poses [1/kg, 1/(kg m^2)]."""
    J = len(known.origin)
    rest, unit = [0.0] * J, np.eye(J).tolist()
    poses = np.random.default_rng(0).uniform(-np.pi, np.pi, (POSES, J)).tolist()
    inertias = np.array(
        [[chains.inverse_dynamics(known, q, rest, ddq, chains.ZERO) for ddq in unit] for q in poses]
    )
    return np.diagonal(np.linalg.inv(inertias), axis1=1, axis2=2).max(0)
