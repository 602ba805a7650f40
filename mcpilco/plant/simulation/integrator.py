"""Accelerations of a motion, and steps through a segment in which its inputs do not jump.

Between two jumps of its input a motion is smooth. It is followed by the pair of Runge-Kutta
formulas of Dormand and Prince, with steps that keep their error estimate below a tolerance; where
dry friction turns over, they become small by themselves. All that is compiled here takes numbers,
of one motion, or packs, of as many as have lanes.

Reference: Dormand & Prince, A family of embedded Runge-Kutta formulae, Journal of Computational and
    Applied Mathematics 6 (1980).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from mcpilco.bodies import (
    INLINED,
    INNER,
    accelerate,
    anywhere,
    count,
    everywhere,
    lane,
    lanes_of,
    where,
    with_lane,
)
from mcpilco.plant.effects.learned import learned_force, place_on
from mcpilco.plant.effects.memory import Moment
from mcpilco.plant.simulation.laws import begin, follow, joint_force, remembers, served
from mcpilco.plant.simulation.signals import drive
from mcpilco.plant.simulation.soft_friction import SOFT, accelerate_softly, slip

POSITION_TOLERANCE, VELOCITY_TOLERANCE = 2e-7, 1e-5
"""of a step [m or rad, m/s or rad/s]"""
SHORTEST = 1e-6
"""step that is taken whatever its error [s]"""
BEGINNINGS = 10
"""turns in which memories and accelerations at a start are found from one another"""
RUNAWAY = 1e4
"""velocity beyond which a motion is given up [m/s or rad/s]"""
AIMED = 0.9
"""to which a step is cut that crosses rest too fast, in speeds over which dry friction turns over
[-]: cut to that speed itself, steps come ever closer to it from above, and none is taken"""
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
def drives_joints(tables, s, q, v, actuated, since, load):
    """Enters the forces of the actuators on each joint, `since` seconds into a segment."""
    for j in range(len(load)):
        load[j] = 0.0
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
    """Where a motion was at the start of a step, as forces that remember need it.

    Or, of packs, where those of all lanes were.
    """

    q: Float[np.ndarray, " J"]
    v: Float[np.ndarray, " J"]
    load: Float[np.ndarray, " J"]
    """what the actuators gave [N or N m]"""
    memory: Float[np.ndarray, "L 2"]
    """of each law; NaN before the first step"""
    alive: Float[np.ndarray, " 1"]
    """1 as long as the motion goes on, 0 where it is lost"""
    systems: Int[np.ndarray, " lanes"]
    """which system moves in each lane"""


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
    memory = past.memory[i, 0], past.memory[i, 1]
    if not (anywhere(gone > 0.0) and remembers(law)):
        return memory
    a, b, c, d = constants_of(tables, s, i)
    before = Moment(past.q[j], past.v[j], kv[0, j], past.load[j])
    now = Moment(q[j], v[j], np.nan, load[j])
    x, y = follow(law, memory, gone, before, now, a, b, c, d)
    return where(gone > 0.0, x, memory[0]), where(gone > 0.0, y, memory[1])


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
    soft = False
    for i in range(len(tables.law)):
        if tables.law[i] == SOFT:
            soft = True
            continue
        j = tables.joint[i]
        x, y = remembered(tables, s, i, q, v, w.load, kv, past, gone)
        a, b, c, d = constants_of(tables, s, i)
        w.x[j] += joint_force(tables.law[i], q[j], v[j], w.load[j], x, y, a, b, c, d)
    for k in range(len(tables.learned.joint)):
        x = grid_place(tables, s, k, 0, q, v, actuated, since)
        y = grid_place(tables, s, k, 1, q, v, actuated, since)
        force = 0.0 * q[0]
        for i in range(lanes_of(force)):
            system = past.systems[i]
            one = learned_force(tables.learned, system, k, lane(x, i), lane(y, i))
            force = with_lane(force, i, one)
        w.x[tables.learned.joint[k]] += force
    if soft:
        accelerate_softly(tables, s, q, v, w, w.x, kv[row])
        return
    accelerate(tables.chains, s, q, v, w, w.x)
    for j in range(J):
        kv[row, j] = w.x[j]


@njit(**INLINED)
def begun(tables, s, load, kv, past, fresh):
    """Moves fresh memories half the way to those of a motion that begins with accelerations kv[0].

    Half of it, for the accelerations follow the memories.
    """
    for i in range(len(tables.law)):
        if remembers(tables.law[i]):
            j = tables.joint[i]
            a, b, c, d = constants_of(tables, s, i)
            now = Moment(past.q[j], past.v[j], kv[0, j], load[j])
            x, y = begin(tables.law[i], now, a, b, c, d)
            past.memory[i, 0] += where(fresh, 0.5 * (x - past.memory[i, 0]), 0.0)
            past.memory[i, 1] += where(fresh, 0.5 * (y - past.memory[i, 1]), 0.0)


@njit(**INNER)
def until_it_turns(tables, s, i, kq, kv, h):
    """The part of a step h until soft friction i begins to stick or to slip; 1 if it may be whole.

    There accelerations have a kink. A step may end a little before it, or after it.
    """
    j, v_r, t = tables.joint[i], tables.constants[s, i, 1], tables.constants[s, i, 2]
    before, soon, after = kq[0, j] + t * kv[0, j], kq[1, j] + t * kv[1, j], kq[6, j] + t * kv[6, j]
    slips = slip(tables, s, i, kq[0, j], kv[0, j])
    later = slip(tables, s, i, kq[6, j], kv[6, j])
    way, first = where(after > before, 1.0, -1.0), 1.0 + 0.0 * h
    leaves, enters = (slips != way) & (later == way), (slips == -way) & (later != slips)
    for edge, passed in ((way * v_r, leaves), (-way * v_r, enters)):
        part = C[1] * (edge - before) / (soon - before)  # what follows the kink says less of it
        part = where((part > 0.0) & (part < 1.0), part, (edge - before) / (after - before))
        near = min(part, 1.0 - part)
        seen = h * abs(kv[6, j] - kv[0, j]) * near * near > VELOCITY_TOLERANCE
        first = where(passed & seen, part, first)
    return first


@njit(**INLINED)
def turning(tables, s, v, tv, kq, kv, h):
    """The part of a step h that ends where dry friction begins to turn over; 1 if it may be whole.

    Between two stages friction can turn over unseen: the estimate of the error is then a hundred
    times too small.
    """
    part = 1.0 + 0.0 * h
    for i in range(len(tables.law)):
        j = tables.joint[i]
        if tables.law[i] == SOFT:
            part = min(part, until_it_turns(tables, s, i, kq, kv, h))
            continue
        width = tables.turn[s, i]
        change = abs(tv[j] - v[j])
        turns = (width > 0.0) & (v[j] * tv[j] < 0.0) & (change > width)
        turns = turns & (h * abs(kv[6, j] - kv[0, j]) > VELOCITY_TOLERANCE)
        if anywhere(turns):
            before = max(abs(v[j]) - width, AIMED * width) / where(turns, change, 1.0)
            part = min(part, where(turns, before, 1.0))
    return part


@njit(**INLINED)
def lose(past, kq, kv, fine):
    """Gives up the motions that are not fine: they stand still from now on."""
    past.alive[0] = where(fine, past.alive[0], 0.0)
    for j in range(len(past.q)):
        past.q[j], past.v[j] = where(fine, past.q[j], 0.0), where(fine, past.v[j], 0.0)
        kq[0, j], kv[0, j] = where(fine, kq[0, j], 0.0), where(fine, kv[0, j], 0.0)
    for i in range(len(past.memory)):
        past.memory[i, 0] = where(fine, past.memory[i, 0], 0.0)
        past.memory[i, 1] = where(fine, past.memory[i, 1], 0.0)


@njit(**INLINED)
def travel(tables, s, past, actuated, duration, step, accuracy, w, kq, kv, tq, tv, taken):
    """Follows a motion through a segment; returns the step that suits its end, or -1 if lost.

    Or the motions of packs, each in steps of its own: what one does is the same beside any others.

    `past` is replaced by where the motion is at the end, and says whether it goes on. `accuracy` is
    the error allowed in a step, in units of the tolerances [-]; kq, kv (7, J) and tq, tv (J,) are
    work space; taken (1,) counts the steps.
    """
    q, v, alive = past.q, past.v, past.alive
    J = len(q)
    done = 0.0 * duration
    first = tried = 0
    for k in range(7):
        for j in range(J):
            kq[k, j] = kv[k, j] = 0.0
    fresh = duration < 0.0  # nowhere yet
    for i in range(len(tables.law)):
        unknown = past.memory[i, 0] != past.memory[i, 0]
        past.memory[i, 0] = where(unknown, 0.0, past.memory[i, 0])
        past.memory[i, 1] = where(unknown, 0.0, past.memory[i, 1])
        if remembers(tables.law[i]) and anywhere(unknown):
            fresh, first = fresh | unknown, -BEGINNINGS
    moving = (duration - done > 1e-12) & (alive[0] > 0.0)
    while anywhere(moving):
        tried += 1
        going = (tried <= 100.0 + MOST_STEPS * duration) | (duration - done <= 1e-12)
        if not everywhere(going):
            lose(past, kq, kv, going)
            moving = moving & going
        taken[0] += count(moving)
        h = where(moving, min(step, duration - done), 0.0)
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
                begun(tables, s, w.load, kv, past, fresh)
            for j in range(J if n == 0 else 0):
                past.load[j] = w.load[j]
        first = 1  # a step begins with the derivative that the one before it ended with
        worst = 0.0 * h
        for j in range(J):
            eq = ev = 0.0
            for k in range(7):
                eq += ERROR[k] * kq[k, j]
                ev += ERROR[k] * kv[k, j]
            worst = max(worst, h * abs(eq) / POSITION_TOLERANCE)
            worst = max(worst, h * abs(ev) / VELOCITY_TOLERANCE)
        worst = worst / accuracy
        finite = worst < 1e30
        if not everywhere(finite):
            worst = where(finite, worst, 1e30)
            for k in range(1, 7):
                for j in range(J):
                    kq[k, j] = where(finite, kq[k, j], 0.0)
                    kv[k, j] = where(finite, kv[k, j], 0.0)
        part = turning(tables, s, v, tv, kq, kv, h)
        kept = moving & (((worst <= 1.0) & (part == 1.0)) | (h <= SHORTEST))
        done = where(kept, done + h, done)
        for i in range(len(tables.law)):
            x, y = remembered(tables, s, i, tq, tv, w.load, kv, past, h)
            past.memory[i, 0] = where(kept, x, past.memory[i, 0])
            past.memory[i, 1] = where(kept, y, past.memory[i, 1])
        for j in range(J):  # the last stage is at the end of the step
            past.load[j] = where(kept, w.load[j], past.load[j])
            q[j], v[j] = where(kept, tq[j], q[j]), where(kept, tv[j], v[j])
            kq[0, j] = where(kept, kq[6, j], kq[0, j])
            kv[0, j] = where(kept, kv[6, j], kv[0, j])
        for j in range(J):
            slow = abs(v[j]) < RUNAWAY
            if not everywhere(slow):
                lose(past, kq, kv, slow)
        factor = min(max(0.9 * (worst + 1e-10) ** -0.2, 0.1), 5.0)
        suits = max(h * where(part == 1.0, factor, min(factor, part)), SHORTEST)
        # a step that the end cut short tells little
        step = where(moving & ((h == step) | (suits < step)), suits, step)
        moving = (duration - done > 1e-12) & (alive[0] > 0.0)
    return where(alive[0] > 0.0, step, -1.0)


def room_for(joints: int, laws: int, *lanes: int) -> tuple[Any, ...]:
    """Work space of `travel`: tq, tv, (J,) each, kq, kv, (7, J) each, and where the motion is.

    Of one motion, or of one in each of some lanes. Handed to compiled functions, for what makes
    arrays itself takes long to compile.
    """
    q, v, load, tq, tv = (np.empty((joints, *lanes)) for _ in range(5))
    memory, alive = np.empty((laws, 2, *lanes)), np.empty((1, *lanes))
    past = Past(q, v, load, memory, alive, np.zeros(lanes or 1, dtype=np.int64))
    return tq, tv, *(np.empty((7, joints, *lanes)) for _ in range(2)), past
