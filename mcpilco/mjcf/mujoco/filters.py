"""Effects beside a MuJoCo model, compiled: commands on their way, forces in joints, sensors.

The formulas are those of the equations' simulation (`mcpilco.plant.simulation`): here a command's
way is followed from jump to jump, and its mean over a timestep is what MuJoCo is given.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mcpilco.bodies import INLINED
from mcpilco.compiling import digest
from mcpilco.plant import (
    GAIN,
    LATENCY,
    OFFSET,
    SCALE,
    SOURCES,
    drive,
    filters_at,
    grid_place,
    joint_force,
    learned_force,
    look,
    next_event,
    prepare,
    settle,
    shaped,
    switch,
)


@njit(**INLINED)
def mean_forces(tables, s, forces, k, begun, end, dt, actuated, y):
    """Fills y (U,) with the means from `begun` to `end` [s], after the command k of shaped ones."""
    now = begun
    for u in range(len(y)):
        y[u] = 0.0
    while now < end:
        switch(tables, s, forces, k, now, dt, actuated)
        event = min(next_event(tables, s, now, dt, actuated), end)
        rest = event - now
        for u in range(len(y)):  # Simpson's rule
            ends = drive(tables, s, u, actuated, 0.0) + drive(tables, s, u, actuated, rest)
            middle = drive(tables, s, u, actuated, 0.5 * rest)
            y[u] += rest / (end - begun) * (ends + 4.0 * middle) / 6.0
        settle(tables, s, rest, actuated)
        now = event


def _compiled(source: str):
    """The loops; where `source`, the digest of the source code, changes, numba compiles anew."""

    @njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
    def actuate(tables, system, window, commands, lead, dt, steps, y):
        """Fills y (B, n, U) with the mean force of each actuator over each timestep.

        Args:
            tables: of S systems.
            system: (B,), of each motion.
            window: (B,), whose commands it gets.
            commands: (W, T_all, U), held for dt each; the first `lead` are only the past.
            lead: commands before the start.
            dt: time for which a command is held [s].
            steps: timesteps while it is.
            y: the result.
        """
        source  # noqa: B018  closed over
        h, U = dt / steps, commands.shape[2]
        forces, actuated = np.empty((commands.shape[1], U)), np.empty((U, 2))
        for b in range(len(system)):
            s = system[b]
            prepare(tables, s, commands, window[b], lead, 0, dt, forces, actuated)
            for i in range(y.shape[1]):
                k, begun = lead + i // steps, (i % steps) * h
                end = dt if i % steps == steps - 1 else begun + h
                mean_forces(tables, s, forces, k, begun, end, dt, actuated, y[b, i])

    @njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
    def step_force(tables, command, h, forces, actuated, first, y):
        """Fills y (U,) with the mean force over a timestep of length h [s], of system 0.

        forces (past, U) and actuated (U, 2) are what is remembered; `first` begins anew.
        """
        source  # noqa: B018
        newest, U = len(forces) - 1, len(command)
        for i in range(newest):
            forces[i] = forces[i + 1]
        for u in range(U):
            last = tables.actuators[0, u, GAIN] * command[u] if first else forces[newest, u]
            forces[newest, u] = shaped(tables.actuators[0, u], command[u], last)
            if first:
                forces[:, u] = forces[newest, u]
                actuated[u] = forces[newest, u]
        mean_forces(tables, 0, forces, newest, 0.0, h, h, actuated, y)

    @njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
    def push(tables, system, q, v, load, actuated, y):
        """Fills y (B, J) with the forces in the joints, at positions q and velocities v (B, J).

        load (B, J) is what actuators give to the joints; actuated (B, U) what each gives.
        """
        source  # noqa: B018
        at = np.zeros((actuated.shape[1], 2))
        for b in range(len(system)):
            s = system[b]
            y[b] = 0.0
            for i in range(len(tables.law)):
                j = tables.joint[i]
                a, c = tables.constants[s, i, 0], tables.constants[s, i, 2]
                p, d = tables.constants[s, i, 1], tables.constants[s, i, 3]
                y[b, j] += joint_force(
                    tables.law[i], q[b, j], v[b, j], load[b, j], 0.0, 0.0, a, p, c, d
                )
            for k in range(len(tables.learned.joint)):
                at[:, 0], at[:, 1] = actuated[b], actuated[b]
                x0 = grid_place(tables, s, k, 0, q[b], v[b], at, 0.0)
                x1 = grid_place(tables, s, k, 1, q[b], v[b], at, 0.0)
                y[b, tables.learned.joint[k]] += learned_force(tables.learned, s, k, x0, x1)

    @njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
    def observe(tables, system, window, path, q, v, steps, dt, every, y):
        """Fills y (B, X, T) with what the sensors see of motions q, v (B, n + 1, J).

        There are `steps` timesteps while a command is held for dt [s], and `every` commands a
        sample; between two timesteps positions are a cubic. path (W, lead + 1, X) is how each
        window's motion came to its start, as measured; or (W, 0, X).
        """
        source  # noqa: B018
        h, T, J = dt / steps, y.shape[2], q.shape[2]
        filters, at, speed = np.empty((2 * J, 3)), np.empty(J), np.empty(J)
        for b in range(len(system)):
            s = system[b]
            filters_at(tables, s, path[window[b]], dt, filters)
            for x in range(2 * J):
                start = v[b, 0, x // 2] if x % 2 else q[b, 0, x // 2]
                late = math.ceil(tables.sensors[s, x, LATENCY] / (every * dt))
                for k in range(min(T, late + 1)):
                    y[b, x, k] = tables.sensors[s, x, OFFSET] + tables.sensors[s, x, SCALE] * start
            for k in range((T - 1) * every + 1):
                now = 0.0
                while now < dt:
                    i = min(int((k * dt + now) / h + 1e-9), q.shape[1] - 1)
                    part = (k * dt + now) / h - i
                    then = min(i + 1, q.shape[1] - 1)
                    if part < 1e-9 or then == i:
                        at[:], speed[:] = q[b, i], v[b, i]
                    else:
                        for j in range(J):
                            rise = q[b, then, j] - q[b, i, j]
                            slope = v[b, i, j]
                            bend = 3.0 * rise - h * (2.0 * slope + v[b, then, j])
                            twist = h * (slope + v[b, then, j]) - 2.0 * rise
                            at[j] = q[b, i, j] + part * (h * slope + part * (bend + part * twist))
                            speed[j] = (1.0 - part) * slope + part * v[b, then, j]
                    look(tables, s, at, speed, k, now, dt, every, y[b], filters)
                    if k == (T - 1) * every:
                        break
                    event = dt
                    for x in range(2 * J):
                        later = -tables.sensors[s, x, LATENCY] % dt
                        if now < later < event:
                            event = later
                    now = event

    return actuate, step_force, push, observe


actuate, step_force, push, observe = _compiled(digest(*SOURCES, "mjcf/mujoco"))
