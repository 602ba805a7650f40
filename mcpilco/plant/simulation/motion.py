"""Motion of many systems under recorded commands, compiled: command, actuator, bodies, sensor.

Between two jumps of its input a motion is smooth. It is followed by the pair of Runge-Kutta
formulas of Dormand and Prince, with steps that keep their error estimate below a tolerance; where
dry friction turns over, they become small by themselves. The jumps themselves are met exactly, a
lag between them is an exponential.

Reference: Dormand & Prince, A family of embedded Runge-Kutta formulae, Journal of Computational and
    Applied Mathematics 6 (1980).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from mcpilco.bodies import INLINED, accelerate, scratch
from mcpilco.compiling import digest
from mcpilco.plant.effects.learned import learned_force, place_on
from mcpilco.plant.effects.memory import Moment
from mcpilco.plant.simulation.laws import (
    begin,
    follow,
    force_of,
    joint_force,
    lagging,
    ramping,
    remembers,
    served,
    shaped,
)
from mcpilco.plant.simulation.layout import (
    COSINE,
    DELAY,
    FILTER,
    GAIN,
    LAG,
    LATENCY,
    OFFSET,
    PLAY,
    RATE,
    SCALE,
    SINE,
    Tables,
)

SOURCES = "bodies", "plant/simulation", "plant/effects"
"""folders of the code that is compiled here"""
POSITION_TOLERANCE, VELOCITY_TOLERANCE = 2e-7, 1e-5
"""of a step [m or rad, m/s or rad/s]"""
PART_OF_NOISE, COARSEST = 1.0 / 30.0, 10.0
"""error of a step that noisy readings allow: a part of their std [-], and at most so many
tolerances [-]; a motion of a second takes some hundred steps, whose errors do not all add up"""
SHORTEST = 1e-6
"""step that is taken whatever its error [s]"""
BEGINNINGS = 10
"""turns in which memories and accelerations at a start are found from one another"""
FORGOTTEN = 37.0
"""times its lag after which what an actuator did before is rounding [-]"""
RUNAWAY = 1e4
"""velocity beyond which a motion is given up [m/s or rad/s]"""
MOST_STEPS = 20000.0
"""in a second, beyond which a motion is given up: it is stiff beyond use"""

A = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [1 / 5, 0, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0],
        [35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
C = (0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0)
ERROR = np.array([71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])
"""fifth-order solution minus the fourth-order one"""


@njit(**INLINED)
def drive(tables, s, u, actuated, since):
    """Force that input u is at, `since` seconds into a segment."""
    lag, rate, goal = tables.actuators[s, u, LAG], tables.actuators[s, u, RATE], actuated[u, 1]
    if lag > 0.0:
        goal = lagging(actuated[u, 0], goal, since, lag)
    if rate < np.inf:
        goal = ramping(actuated[u, 0], goal, since, rate)
    return goal


@njit(**INLINED)
def drives_joints(tables, s, q, v, actuated, since, load):
    """Enters the forces of the actuators on each joint, `since` seconds into a segment."""
    load[:] = 0.0
    for u in range(len(tables.drives)):
        j, x = tables.drives[u], drive(tables, s, u, actuated, since)
        load[j] += served(tables.actuators[s, u], x, q[j], v[j])


@njit(**INLINED)
def grid_place(tables, s, k, a, q, v, actuated, since):
    """Where a motion is on axis a of the grid of learned force k; 0 where there is no such axis."""
    axis, J = tables.learned.axis[k, a], len(q)
    if axis < 0:
        return 0.0
    if axis >= 2 * J:
        x = drive(tables, s, axis - 2 * J, actuated, since)
    else:
        x = v[axis // 2] if axis % 2 else q[axis // 2]
    return place_on(tables.learned, k, a, x)


class Past(NamedTuple):
    """Where a motion was at the start of a step, as forces that remember need it."""

    q: Float[np.ndarray, " J"]
    v: Float[np.ndarray, " J"]
    load: Float[np.ndarray, " J"]
    """what the actuators gave [N or N m]"""
    memory: Float[np.ndarray, "L 2"]
    """of each law; NaN before the first step"""


@njit(**INLINED)
def constants_of(tables, s, i):
    """The constants of law i."""
    own = tables.constants
    return own[s, i, 0], own[s, i, 1], own[s, i, 2], own[s, i, 3]


@njit(**INLINED)
def remembered(tables, s, i, q, v, load, kv, past, gone):
    """The memory of law i, `gone` seconds after the start of a step; 0 if it has none.

    kv[0] are the accelerations at the start.
    """
    law, j = tables.law[i], tables.joint[i]
    if not remembers(law):
        return 0.0, 0.0
    memory = past.memory[i, 0], past.memory[i, 1]
    if gone == 0.0:
        return memory
    a, b, c, d = constants_of(tables, s, i)
    before = Moment(past.q[j], past.v[j], kv[0, j], past.load[j])
    now = Moment(q[j], v[j], np.nan, load[j])
    return follow(law, memory, gone, before, now, a, b, c, d)


@njit(**INLINED)
def derivative(tables, s, q, v, actuated, since, w, kv, row, past, gone):
    """Accelerations at positions q and velocities v, `since` seconds into a segment, into kv[row].

    actuated[u] holds the force that input u is at, and the one that it lags behind. The step began
    `gone` seconds ago, at `past`.
    """
    J = len(q)
    drives_joints(tables, s, q, v, actuated, since, w.load)
    for j in range(J):
        w.x[j] = w.load[j]
    for i in range(len(tables.law)):
        j = tables.joint[i]
        x, y = remembered(tables, s, i, q, v, w.load, kv, past, gone)
        a, b, c, d = constants_of(tables, s, i)
        w.x[j] += joint_force(tables.law[i], q[j], v[j], w.load[j], x, y, a, b, c, d)
    for k in range(len(tables.learned.joint)):
        x = grid_place(tables, s, k, 0, q, v, actuated, since)
        y = grid_place(tables, s, k, 1, q, v, actuated, since)
        w.x[tables.learned.joint[k]] += learned_force(tables.learned, s, k, x, y)
    accelerate(tables.chains, s, q, v, w, w.x)
    for j in range(J):
        kv[row, j] = w.x[j]


@njit(**INLINED)
def begun(tables, s, load, kv, past):
    """Moves the memories half the way to those of a motion that begins with accelerations kv[0].

    Half of it, for the accelerations follow the memories.
    """
    for i in range(len(tables.law)):
        if remembers(tables.law[i]):
            j = tables.joint[i]
            a, b, c, d = constants_of(tables, s, i)
            now = Moment(past.q[j], past.v[j], kv[0, j], load[j])
            x, y = begin(tables.law[i], now, a, b, c, d)
            past.memory[i, 0] += 0.5 * (x - past.memory[i, 0])
            past.memory[i, 1] += 0.5 * (y - past.memory[i, 1])


@njit(**INLINED)
def turning(tables, s, v, tv, kv, h):
    """The part of a step h that ends where dry friction begins to turn over; 1 if it may be whole.

    Between two stages friction can turn over unseen: the estimate of the error is then a hundred
    times too small.
    """
    part = 1.0
    for i in range(len(tables.law)):
        j = tables.joint[i]
        width = tables.turn[s, i]
        change = abs(tv[j] - v[j])
        noticeable = h * abs(kv[6, j] - kv[0, j]) > VELOCITY_TOLERANCE
        if width > 0.0 and v[j] * tv[j] < 0.0 and change > width and noticeable:
            part = min(part, max(abs(v[j]) - width, width) / change)
    return part


@njit(**INLINED)
def travel(tables, s, past, actuated, duration, step, accuracy, w, kq, kv, tq, tv, taken):
    """Follows a motion through a segment; returns the step that suits its end, or -1 if lost.

    `past` is replaced by where the motion is at the end. `accuracy` is the error allowed in a step,
    in units of the tolerances [-]; kq, kv (7, J) and tq, tv (J,) are work space; taken (1,) counts
    the steps.
    """
    q, v = past.q, past.v
    J = len(q)
    done = 0.0
    first = tried = 0
    kq[:] = 0.0
    kv[:] = 0.0
    for i in range(len(tables.law)):
        if past.memory[i, 0] != past.memory[i, 0]:
            past.memory[i, 0] = past.memory[i, 1] = 0.0
            if remembers(tables.law[i]):
                first = -BEGINNINGS
    while duration - done > 1e-12:
        tried += 1
        taken[0] += 1
        if tried > 100.0 + MOST_STEPS * duration:
            return -1.0
        h = min(step, duration - done)
        for n in range(first, 7):
            i = max(n, 0)
            for j in range(J):
                dq = dv = 0.0
                for k in range(6):  # A is 0 from row i on: a loop of one length is much faster
                    dq += A[i, k] * kq[k, j]
                    dv += A[i, k] * kv[k, j]
                tq[j] = q[j] + h * dq
                tv[j] = kq[i, j] = v[j] + h * dv
            gone = C[i] * h
            derivative(tables, s, tq, tv, actuated, done + gone, w, kv, i, past, gone)
            if n < 0:
                begun(tables, s, w.load, kv, past)
            for j in range(J if n == 0 else 0):
                past.load[j] = w.load[j]
        first = 1  # a step begins with the derivative that the one before it ended with
        worst = 0.0
        for j in range(J):
            eq = ev = 0.0
            for k in range(7):
                eq += ERROR[k] * kq[k, j]
                ev += ERROR[k] * kv[k, j]
            worst = max(worst, h * abs(eq) / POSITION_TOLERANCE, h * abs(ev) / VELOCITY_TOLERANCE)
        worst /= accuracy
        if not worst < 1e30:  # NaN or infinite
            worst = 1e30
            kq[1:] = 0.0
            kv[1:] = 0.0
        part = turning(tables, s, v, tv, kv, h)
        if (worst <= 1.0 and part == 1.0) or h <= SHORTEST:
            done += h
            for i in range(len(tables.law)):
                x, y = remembered(tables, s, i, tq, tv, w.load, kv, past, h)
                past.memory[i, 0], past.memory[i, 1] = x, y
            for j in range(J):  # the last stage is at the end of the step
                past.load[j] = w.load[j]
                q[j], v[j] = tq[j], tv[j]
                kq[0, j], kv[0, j] = kq[6, j], kv[6, j]
                if not abs(v[j]) < RUNAWAY:
                    return -1.0
        factor = min(max(0.9 * (worst + 1e-10) ** -0.2, 0.1), 5.0)
        suits = max(h * (factor if part == 1.0 else min(factor, part)), SHORTEST)
        if h == step or suits < step:  # a step that the end cut short tells little
            step = suits
    return step


@njit(**INLINED)
def within(late, dt):
    """When in a command's time dt something happens that comes so late [s]."""
    return late % dt if late != 0.0 else 0.0  # a remainder takes as long as 20 products


@njit(**INLINED)
def next_event(tables, s, now, dt, actuated):
    """When an input jumps, a ramp ends or a sensor looks next after `now`; dt if never before."""
    event = dt
    for u in range(len(tables.drives)):
        at = within(tables.actuators[s, u, DELAY], dt)
        if now < at < event:
            event = at
        at = now + abs(actuated[u, 1] - actuated[u, 0]) / tables.actuators[s, u, RATE]
        if tables.actuators[s, u, LAG] == 0.0 and now < at < event:
            event = at
    for x in range(tables.sensors.shape[1]):
        at = within(-tables.sensors[s, x, LATENCY], dt)
        if now < at < event:
            event = at
    return event


@njit(**INLINED)
def look(tables, s, q, v, k, now, dt, every, y, filters):
    """Enters what the sensors see `now` seconds after command k, for those that look now.

    Each `every`-th command comes with a sample. filters (X, 3) are position and velocity when each
    looked last, and what its filter made of them; NaN before the first look.
    """
    for x in range(y.shape[0]):
        latency = tables.sensors[s, x, LATENCY]
        if within(-latency, dt) == now:
            row, between = divmod(k + round((now + latency) / dt), every)
            if between == 0 and row < y.shape[1]:
                j, sensor = x // 2, tables.sensors[s, x]
                seen = v[j] if x % 2 else q[j]
                if sensor[FILTER] > 0.0:
                    seen = filtered(filters[x], x % 2, q[j], v[j], every * dt, sensor[FILTER])
                if sensor[SINE] != 0.0 or sensor[COSINE] != 0.0:
                    seen += sensor[SINE] * math.sin(seen) + sensor[COSINE] * math.cos(seen)
                y[x, row] = sensor[OFFSET] + sensor[SCALE] * seen


@njit(**INLINED)
def filtered(filter, of_velocity, q, v, dt, T):
    """The output y of T y' = x - y, of a position or its velocity x in the last dt [s].

    Position and velocity at both ends make the motion between a cubic, of which
    x - T Dx + T^2 D^2 x - T^3 D^3 x, with D for d/dt, solves the equation.
    """
    if filter[0] != filter[0]:
        if filter[2] != filter[2]:  # it lags behind a motion that went on as it is
            filter[2] = v if of_velocity else q - T * v
    else:
        mean = (q - filter[0]) / dt
        jerk = 6.0 * (filter[1] + v - 2.0 * mean) / dt**2
        a1 = (4.0 * v + 2.0 * filter[1] - 6.0 * mean) / dt  # at the end
        a0 = a1 - jerk * dt
        begun, ended = filter[1] - T * (a0 - T * jerk), v - T * (a1 - T * jerk)
        if not of_velocity:
            begun, ended = filter[0] - T * begun, q - T * ended
        filter[2] = ended + (filter[2] - begun) * math.exp(-dt / T)
    filter[0], filter[1] = q, v
    return filter[2]


@njit(**INLINED)
def filters_at(tables, s, path, dt, filters):
    """Enters what the sensors' filters made of a measured path (n, X), where there is one.

    Its positions have come out of the filters, its velocities are made of positions.
    """
    for x in range(len(filters)):
        filters[x] = np.nan
        T, last = tables.sensors[s, x, FILTER], len(path) - 1
        if T > 0.0 and last >= 0:
            scale, j = tables.sensors[s, x, SCALE], x // 2
            filters[x, 2] = (path[last, x] - tables.sensors[s, x, OFFSET]) / scale
            first = max(0, last - math.ceil(FORGOTTEN * T / dt)) if x % 2 else last + 1
            for i in range(first, last + 1):
                if i == first:
                    filters[x, 2] = path[i, x]
                filtered(filters[x], True, path[i, 2 * j], path[i, 2 * j + 1], dt, T)
            filters[x, 0] = np.nan


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


@njit(**INLINED)
def recent(tables, s, dt, lead):
    """How many of the `lead` commands before a start still show in where the actuators are."""
    kept = min(lead, 1)
    for u in range(len(tables.drives)):
        if tables.actuators[s, u, RATE] < np.inf:
            return lead
        kept = max(kept, min(lead, 1 + math.ceil(FORGOTTEN * tables.actuators[s, u, LAG] / dt)))
    return kept


@njit(**INLINED)
def prepare(tables, s, commands, n, lead, followed, dt, forces, actuated):
    """The shaped commands of window n, and where the actuators are `followed` before the start.

    Of the `lead` commands before it those are left out that no longer matter.
    """
    first = lead - max(recent(tables, s, dt, lead), followed)
    for u in range(len(tables.drives)):
        late = 1 + int(tables.actuators[s, u, DELAY] / dt)
        begin = max(first - late, 0) if tables.actuators[s, u, PLAY] == 0.0 else 0
        last = tables.actuators[s, u, GAIN] * commands[n, begin, u]
        for i in range(begin, commands.shape[1]):
            last = shaped(tables.actuators[s, u], commands[n, i, u], last)
            forces[i, u] = last
        actuated[u, 0] = actuated[u, 1] = forces[begin, u]
    for i in range(first, lead - followed):
        hold(tables, s, forces, i, dt, actuated)


@njit(**INLINED)
def hold(tables, s, forces, i, dt, actuated):
    """Moves the actuators on by the time of command i."""
    now = 0.0
    while now < dt:
        switch(tables, s, forces, i, now, dt, actuated)
        event = next_event(tables, s, now, dt, actuated)
        settle(tables, s, event - now, actuated)
        now = event


@njit(**INLINED)
def switch(tables, s, forces, i, now, dt, actuated):
    """Sets the forces that the actuators are driven to, `now` seconds after command i."""
    for u in range(len(tables.drives)):
        delay = tables.actuators[s, u, DELAY]
        late = 0
        if delay != 0.0:
            late = int(delay // dt) + (now < delay % dt)
        actuated[u, 1] = forces[max(i - late, 0), u]


@njit(**INLINED)
def settle(tables, s, duration, actuated):
    """Where the actuators are after so long a time."""
    for u in range(len(tables.drives)):
        actuated[u, 0] = drive(tables, s, u, actuated, duration)


def _compiled(source: str):
    """The loop `follow` over motions, compiled.

    Where `source`, the digest of the source code, changes, numba compiles anew.
    """

    @njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
    def follow(
        tables, system, start, window, commands, lead, dt, every, accuracy, path, y, w, room, memory
    ):
        """Fills y (B, X, T), NaN before, with what is measured of B motions, until one is lost.

        Args:
            tables: of S systems.
            system: (B,), which of them moves.
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
            w: work space of `mcpilco.bodies.compiled.scratch`.
            room: that of `room_for`.
            memory: room for the shaped commands (T_all, U), where the actuators are (U, 2) and what
                the sensors' filters have seen (X, 3), and the steps of the integrator (1,), which
                are counted on.
        """
        source  # noqa: B018  closed over
        T = y.shape[2]
        forces, actuated, filters, taken = memory
        tq, tv, kq, kv, past = room
        q, v = past.q, past.v
        recalls = False
        for law in tables.law:
            recalls |= path.shape[1] > 0 and remembers(law)
        for b in range(len(start)):
            s, n = system[b], window[b]
            for j in range(len(q)):
                q[j], v[j] = start[b, 2 * j], start[b, 2 * j + 1]
            past.memory[:] = np.nan
            followed = lead if recalls else 0
            prepare(tables, s, commands, n, lead, followed, dt, forces, actuated)
            for i in range(followed):
                switch(tables, s, forces, i, 0.0, dt, actuated)
                here, then = path[n, i], path[n, i + 1]
                drives_joints(tables, s, here[0::2], here[1::2], actuated, 0.0, past.load)
                hold(tables, s, forces, i, dt, actuated)
                drives_joints(tables, s, then[0::2], then[1::2], actuated, 0.0, w.load)
                recall(tables, s, path[n, i : i + 2], dt, past, w.load)
            filters_at(tables, s, path[n], dt, filters)
            for x in range(2 * len(q)):  # before the first look of a sensor that lags behind
                offset, scale = tables.sensors[s, x, OFFSET], tables.sensors[s, x, SCALE]
                late = math.ceil(tables.sensors[s, x, LATENCY] / (every * dt))
                for k in range(min(T, late + 1)):
                    y[b, x, k] = offset + scale * start[b, x]
            step = dt
            for k in range((T - 1) * every + 1):
                now = 0.0
                switch(tables, s, forces, lead + k, now, dt, actuated)
                look(tables, s, q, v, k, now, dt, every, y[b], filters)
                if k == (T - 1) * every:
                    break
                while now < dt and step > 0.0:
                    event = next_event(tables, s, now, dt, actuated)
                    rest = event - now
                    step = travel(
                        tables, s, past, actuated, rest, step, accuracy, w, kq, kv, tq, tv, taken
                    )
                    settle(tables, s, event - now, actuated)
                    now = event
                    if now < dt and step > 0.0:
                        switch(tables, s, forces, lead + k, now, dt, actuated)
                        look(tables, s, q, v, k, now, dt, every, y[b], filters)
                if step < 0.0:
                    break

    return follow


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
    memory = np.empty((T, U)), np.empty((U, 2)), np.empty((2 * J, 3)), taken
    room = room_for(J, len(tables.law))
    path = np.empty((len(commands), 0, 2 * J)) if path is None else path
    start, path = map(np.ascontiguousarray, (start, path))  # each layout would be compiled for
    given = tables, system, start, window, commands, lead, dt, every, accuracy, path
    _follow(*given, y, scratch(J), room, memory)
    return y


def room_for(joints: int, laws: int) -> tuple[Any, ...]:
    """Work space of `travel`: tq, tv, (J,) each, kq, kv, (7, J) each, and where the motion is.

    Handed to compiled functions, for what makes arrays itself takes long to compile.
    """
    q, v, load, tq, tv = np.empty((5, joints))
    return tq, tv, *np.empty((2, 7, joints)), Past(q, v, load, np.empty((laws, 2)))
