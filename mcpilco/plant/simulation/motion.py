"""Motion of many systems under recorded commands, compiled: command, actuator, bodies, sensor.

Motions are followed side by side, one in each lane of packs (`mcpilco.bodies.packs`), each in steps
of its own: it is the same beside any others. What differs between them by an `if`, their commands
and sensors, is done lane by lane. The jumps of inputs are met exactly.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from mcpilco.bodies import INLINED, INNER, LANES, Chains, anywhere, as_packs, scratch
from mcpilco.compiling import digest
from mcpilco.plant.effects.memory import Moment
from mcpilco.plant.simulation.integrator import (
    POSITION_TOLERANCE,
    VELOCITY_TOLERANCE,
    Past,
    constants_of,
    drives_joints,
    room_for,
    travel,
)
from mcpilco.plant.simulation.laws import begin, follow, force_of, remembers
from mcpilco.plant.simulation.layout import LATENCY, OFFSET, SCALE, Tables
from mcpilco.plant.simulation.signals import (
    filters_at,
    hold,
    is_direct,
    is_quiet,
    look,
    next_event,
    prepare,
    settle,
    switch,
)

SOURCES = "bodies", "plant/simulation", "plant/effects"
"""folders of the code that is compiled here"""
COUNTED = {**INNER, "_nrt": True}
"""for functions that give arrays back, which are counted"""
PART_OF_NOISE, COARSEST = 1.0 / 30.0, 10.0
"""error of a step that noisy readings allow: a part of their std [-], and at most so many
tolerances [-]; a motion of a second takes some hundred steps, whose errors do not all add up"""


@njit(**INLINED)
def recall(tables, s, path, dt, past, load):
    """Follows the memories along a measured path (2, X) over one command.

    `past.load` is what the actuators gave at its beginning, `load` at its end.
    """
    for i in range(len(tables.law)):
        if remembers(tables.law[i]):
            j = tables.joint[i]
            a, b, c, d = constants_of(tables, s, i)
            mean = (path[1, 2 * j + 1] - path[0, 2 * j + 1]) / dt
            before = Moment(path[0, 2 * j], path[0, 2 * j + 1], mean, past.load[j])
            now = Moment(path[1, 2 * j], path[1, 2 * j + 1], mean, load[j])
            memory = past.memory[i, 0], past.memory[i, 1]
            if memory[0] != memory[0]:
                memory = begin(tables.law[i], before, a, b, c, d)
            x, y = follow(tables.law[i], memory, dt, before, now, a, b, c, d)
            past.memory[i, 0], past.memory[i, 1] = x, y


@njit(**INNER)
def enter_row(numbers, packed, k):
    """Puts the numbers of a row into lane k."""
    for i in range(len(numbers)):
        packed[i, k] = numbers[i]


@njit(**INNER)
def enter_table(numbers, packed, k):
    """Puts the numbers of a table into lane k."""
    for i in range(len(numbers)):
        enter_row(numbers[i], packed[i], k)


class Numbers(NamedTuple):
    """Those of `Chains` and `Tables` in which systems differ, of the system in each lane."""

    origin: Float[np.ndarray, "1 J 3 lanes"]
    mass: Float[np.ndarray, "1 J lanes"]
    center: Float[np.ndarray, "1 J 3 lanes"]
    inertia: Float[np.ndarray, "1 J 3 3 lanes"]
    armature: Float[np.ndarray, "1 J lanes"]
    gravity: Float[np.ndarray, "1 3 lanes"]
    constants: Float[np.ndarray, "1 L 4 lanes"]
    turn: Float[np.ndarray, "1 L lanes"]
    actuators: Float[np.ndarray, "1 U 15 lanes"]
    sensors: Float[np.ndarray, "1 X 6 lanes"]


@njit(**INNER)
def enter(tables, s, numbers, k):
    """Puts those of system s into lane k."""
    chains = tables.chains
    enter_table(chains.origin[s], numbers.origin[0], k)
    enter_row(chains.mass[s], numbers.mass[0], k)
    enter_table(chains.center[s], numbers.center[0], k)
    for j in range(chains.inertia.shape[1]):
        enter_table(chains.inertia[s, j], numbers.inertia[0, j], k)
    enter_row(chains.armature[s], numbers.armature[0], k)
    enter_row(chains.gravity[s], numbers.gravity[0], k)
    enter_table(tables.constants[s], numbers.constants[0], k)
    enter_row(tables.turn[s], numbers.turn[0], k)
    enter_table(tables.actuators[s], numbers.actuators[0], k)
    enter_table(tables.sensors[s], numbers.sensors[0], k)


@njit(**COUNTED)
def tables_of(tables, numbers):
    """The tables of one system whose numbers are packs."""
    c, n = tables.chains, as_packs(numbers)
    shape = c.parent, c.slides, c.planar, c.axis, c.rotation
    own = n.origin, n.mass, n.center, n.inertia, n.armature, n.gravity
    given = tables.law, tables.joint, n.constants, n.turn, tables.drives, n.actuators, n.sensors
    return Tables(Chains(*shape, *own), *given, tables.learned)


@njit(**COUNTED)
def lane_of(past, k):
    """Where the motion of lane k was."""
    q, v, load = past.q[:, k], past.v[:, k], past.load[:, k]
    return Past(q, v, load, past.memory[:, :, k], past.alive[:, k], past.systems)


@njit(**INNER)
def start_lane(tables, s, start, n, commands, lead, dt, path, forces, actuated, past):
    """Where a motion of system s begins, of the commands and path of window n."""
    past.alive[0] = 1.0
    followed, then_load = 0, past.v  # room, before the start is known
    for i in range(len(tables.law)):
        past.memory[i, 0] = past.memory[i, 1] = np.nan
        if path.shape[1] > 0 and remembers(tables.law[i]):
            followed = lead
    prepare(tables, s, commands, n, lead, followed, dt, forces, actuated)
    for i in range(followed):
        switch(tables, s, forces, i, 0.0, dt, actuated)
        here, then = path[n, i], path[n, i + 1]
        drives_joints(tables, s, here[0::2], here[1::2], actuated, 0.0, past.load)
        hold(tables, s, forces, i, dt, actuated)
        drives_joints(tables, s, then[0::2], then[1::2], actuated, 0.0, then_load)
        recall(tables, s, path[n, i : i + 2], dt, past, then_load)
    for j in range(len(past.q)):
        past.q[j], past.v[j] = start[2 * j], start[2 * j + 1]


@njit(**INNER)
def look_first(tables, s, start, every, dt, y):
    """Enters what a sensor that lags behind shows before its first look."""
    for x in range(len(start)):
        late = math.ceil(tables.sensors[s, x, LATENCY] / (every * dt))
        for k in range(min(y.shape[1], late + 1)):
            y[x, k] = tables.sensors[s, x, OFFSET] + tables.sensors[s, x, SCALE] * start[x]


@njit(**INNER)
def look_at(tables, s, q, v, y):
    """Enters what sensors see now that are neither late nor filtered, nor bent."""
    for x in range(len(y)):
        seen = v[x // 2] if x % 2 else q[x // 2]
        y[x] = tables.sensors[s, x, OFFSET] + tables.sensors[s, x, SCALE] * seen


# What follows is done in all lanes of which the motion goes on, and is not at the end of a command.


@njit(**INNER)
def switch_all(tables, lanes, forces, i, nows, dt, at):
    """Sets the forces that the actuators are driven to, some time after command i."""
    for k in range(LANES):
        if lanes.alive[0, k] > 0.0 and nows[k] < dt:
            switch(tables, lanes.systems[k], forces[k], i, nows[k], dt, at[:, :, k])


@njit(**INNER)
def look_all(tables, lanes, motions, i, nows, dt, every, y, filters, direct):
    """Enters what the sensors see, some time after command i."""
    for k in range(len(motions)):
        if lanes.alive[0, k] > 0.0 and nows[k] < dt:
            s, q, v, seen = lanes.systems[k], lanes.q[:, k], lanes.v[:, k], y[motions[k]]
            if not direct[k]:
                look(tables, s, q, v, i, nows[k], dt, every, seen, filters[k])
            elif nows[k] == 0.0 and i % every == 0:
                look_at(tables, s, q, v, seen[:, i // every])


@njit(**INNER)
def next_events(tables, lanes, nows, dt, at, events):
    """Enters when an input jumps, a ramp ends or a sensor looks next."""
    for k in range(LANES):
        if lanes.alive[0, k] > 0.0 and nows[k] < dt:
            events[k] = next_event(tables, lanes.systems[k], nows[k], dt, at[:, :, k])


@njit(**INNER)
def settle_all(tables, lanes, nows, events, at):
    """Where the actuators are at the events."""
    for k in range(LANES):
        if lanes.alive[0, k] > 0.0 and events[k] > nows[k]:
            settle(tables, lanes.systems[k], events[k] - nows[k], at[:, :, k])


def _compiled(source: str):
    """The loop `follow_all` over motions, compiled.

    Where `source`, the digest of the source code, changes, numba compiles anew.
    """

    @njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
    def follow_all(
        tables,
        system,
        order,
        start,
        window,
        commands,
        lead,
        dt,
        every,
        accuracy,
        path,
        y,
        numbers,
        w,
        room,
        memory,
    ):
        """Fills y (B, X, T), NaN before, with what is measured of B motions, until they are lost.

        Args:
            tables: of S systems.
            system: (B,), which of them moves.
            order: (B,), motions of which some that follow one another are done together.
            start: (B, X), state at command `lead` of its window.
            window: (B,), whose commands it gets.
            commands: (W, lead + T every, U), held for dt each; the first `lead` are only the past
                of the actuators.
            lead: commands before the start.
            dt: time for which a command is held [s].
            every: commands a sample.
            accuracy: error allowed in a step, in units of the tolerances [-].
            path: (W, lead + 1, X), how each window's motion came to its start, as measured; or
                (W, 0, X).
            y: the result.
            numbers: room for those of the system in each lane.
            w: work space of `mcpilco.bodies.compiled.scratch`, of packs.
            room: that of `room_for`, of packs.
            memory: room for the shaped commands of each lane (lanes, T_all, U), where the actuators
                are (U, 2, lanes), what the sensors' filters have seen (lanes, X, 3), three times of
                each lane, (1, lanes) each, whether it has sensors for `look_at`, and the steps of
                the integrator (1,), which are counted on.
        """
        source  # noqa: B018  closed over
        forces, at, filters, times, direct, taken = memory
        last, lanes, systems = (y.shape[2] - 1) * every, room[4], room[4].systems
        packed, w, actuated = tables_of(tables, numbers), as_packs(w), as_packs((at,))[0]
        tq, tv, kq, kv, past = as_packs(room)
        now, event, step = as_packs(times)
        nows, events = times[0][0], times[1][0]
        zero = np.int64(0)
        systems[:] = -1
        for first in range(0, len(order), LANES):
            motions, quiet = order[first : first + LANES], True
            for k in range(LANES):
                b = motions[min(k, len(motions) - 1)]
                s, n, own = system[b], window[b], lane_of(lanes, k)
                if systems[k] != s:
                    enter(tables, s, numbers, k)
                    systems[k] = s
                start_lane(
                    tables, s, start[b], n, commands, lead, dt, path, forces[k], at[:, :, k], own
                )
                if k >= len(motions):  # it is left over
                    own.alive[0] = 0.0
                    continue
                filters_at(tables, s, path[n], dt, filters[k])
                look_first(tables, s, start[b], every, dt, y[b])
                direct[k] = is_direct(tables, s)
                quiet &= is_quiet(tables, s, dt)
            step[0] = dt
            for i in range(last + 1):
                now[0] = 0.0
                while anywhere((now[0] < dt) & (past.alive[0] > 0.0)):
                    switch_all(tables, lanes, forces, lead + i, nows, dt, at)
                    look_all(tables, lanes, motions, i, nows, dt, every, y, filters, direct)
                    if i == last:
                        break
                    event[0] = dt
                    if not quiet:
                        next_events(tables, lanes, nows, dt, at, events)
                    step[0] = travel(
                        *(packed, zero, past, actuated, event[0] - now[0], step[0], accuracy),
                        *(w, kq, kv, tq, tv, taken),
                    )
                    settle_all(tables, lanes, nows, events, at)
                    now[0] = event[0]

    return follow_all


_follow = _compiled(digest(*SOURCES))


def accuracy_for(std: Float[np.ndarray, " X"]) -> float:
    """The error of a step that is far below the noise of readings [tolerances of `simulate`].

    Args:
        std: of the noise of [q1, q1', q2, ...], each in its unit.
    """
    tolerances = np.tile([POSITION_TOLERANCE, VELOCITY_TOLERANCE], len(std) // 2)
    return float(np.clip(PART_OF_NOISE * np.min(std / tolerances), 1.0, COARSEST))


def simulate(
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
    """The measured states of B motions, at T samples; NaN from where a motion runs away.

    Args:
        tables: of S systems.
        system: which of them moves.
        start: [q1, q1', q2, q2', ...] at command `lead` of the motion's window.
        window: whose commands it gets.
        commands: of W windows, each held for dt; the first `lead` are only the past of the
            actuators, and T = (T_all - lead) / every.
        lead: how many these are.
        dt: time for which a command is held [s].
        taken: the steps of the integrator are added to it.
        every: commands a sample; a machine may be driven faster than its motion is compared.
        path: the states at each command before the start and at it, as measured: forces that
            remember and filters of sensors follow them; None: they begin with the motion.
        accuracy: error allowed in a step of the integrator, in units of its tolerances [-].

    Raises:
        InputError: a law that no effect has.
    """
    for law in tables.law:
        force_of(law)
    y = np.full((*start.shape, (commands.shape[1] - lead) // every), np.nan)
    J, (_, T, U) = start.shape[1] // 2, commands.shape
    taken = np.zeros(1, dtype=np.int64) if taken is None else taken
    memory = (
        *(np.empty((LANES, T, U)), np.zeros((U, 2, LANES)), np.empty((LANES, 2 * J, 3))),
        *(tuple(np.empty((3, 1, LANES))), np.empty(LANES, dtype=np.bool_), taken),
    )
    path = np.empty((len(commands), 0, 2 * J)) if path is None else path
    start, path = map(np.ascontiguousarray, (start, path))  # each layout would be compiled for
    order = np.argsort(window, kind="stable")  # motions of a window take the same steps
    given = tables, system, order, start, window, commands, lead, dt, every, accuracy, path
    both = {**tables.chains._asdict(), **tables._asdict()}
    shapes = ((1, *both[name].shape[1:], LANES) for name in Numbers._fields)
    numbers = Numbers(*map(np.empty, shapes))
    _follow(*given, y, numbers, scratch(J, LANES), room_for(J, len(tables.law), LANES), memory)
    return y
