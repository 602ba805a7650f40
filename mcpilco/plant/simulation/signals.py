"""Commands on their way to the joints, and what the sensors see, compiled.

An input jumps when a command comes out of its delay; between two jumps a lag is an exponential and
a limited rate a ramp. A sensor looks when its latency says so.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mcpilco.bodies import INLINED, anywhere, where
from mcpilco.plant.simulation.laws import lagging, ramping, shaped
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
)

FORGOTTEN = 37.0
"""times its lag after which what an actuator did before is rounding [-]"""


@njit(**INLINED)
def drive(tables, s, u, actuated, since):
    """Force that input u is at, `since` seconds into a segment."""
    lag, rate, goal = tables.actuators[s, u, LAG], tables.actuators[s, u, RATE], actuated[u, 1]
    if anywhere(lag > 0.0):
        goal = where(lag > 0.0, lagging(actuated[u, 0], goal, since, lag), goal)
    if anywhere(rate < np.inf):
        goal = where(rate < np.inf, ramping(actuated[u, 0], goal, since, rate), goal)
    return goal


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
            if between == 0 and 0 <= row < y.shape[1]:
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


@njit(**INLINED)
def is_quiet(tables, s, dt):
    """Whether inputs jump with the commands alone, and sensors look with them."""
    quiet = True
    for u in range(len(tables.drives)):
        quiet &= within(tables.actuators[s, u, DELAY], dt) == 0.0
        quiet &= tables.actuators[s, u, RATE] == np.inf
    for x in range(tables.sensors.shape[1]):
        quiet &= within(-tables.sensors[s, x, LATENCY], dt) == 0.0
    return quiet


@njit(**INLINED)
def is_direct(tables, s):
    """Whether the sensors are neither late nor filtered, nor bent."""
    plain = True
    for x in range(tables.sensors.shape[1]):
        for column in (LATENCY, FILTER, SINE, COSINE):
            plain &= tables.sensors[s, x, column] == 0.0
    return plain
