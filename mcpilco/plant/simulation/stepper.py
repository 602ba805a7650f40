"""Motions that go on from command to command, as an env needs them."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float
from numba import njit

from mcpilco.bodies import scratch
from mcpilco.compiling import digest
from mcpilco.plant.simulation.integrator import Past, room_for, travel
from mcpilco.plant.simulation.laws import shaped
from mcpilco.plant.simulation.layout import (
    COSINE,
    DELAY,
    FILTER,
    LATENCY,
    OFFSET,
    SCALE,
    SINE,
    Tables,
)
from mcpilco.plant.simulation.motion import SOURCES
from mcpilco.plant.simulation.signals import look, next_event, settle, switch

ACCURACY = 1e-3
"""error allowed in an integrator's step, relative to that of `simulate` [-]: the motion of an env
is the truth that others are compared with"""


def _compiled(source: str):
    """The loop `advance` over motions, compiled.

    Where `source`, the digest of the source code, changes, numba compiles anew.
    """

    @njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
    def advance(
        tables, commands, dt, states, forces, actuated, seen, filters, memory, path, w, room
    ):
        """Holds commands (B, U) for dt; fills path (T, B, X) with the states on the way.

        Args:
            tables: of one system, that all motions share.
            commands: one for each motion and input.
            dt: how long [s].
            states: (B, X), replaced by those at the end.
            forces: (B, past, U), the last shaped commands, the newest at the end.
            actuated: (B, U, 2), the force that each input is at, and the one that it lags behind.
            seen: (B, X, future), what the sensors see now and at the next samples.
            filters: (B, X, 3), of `look`.
            memory: (B, L, 2), of the forces in joints.
            path: the states at T equally spaced times, the last one at the end; NaN where lost.
            w: work space of `mcpilco.bodies.compiled.scratch`.
            room: tq, tv, kq, kv, past and taken of `travel`, see `room_for`.
        """
        source  # noqa: B018  closed over
        T, B, X = path.shape
        tq, tv, kq, kv, (q, v, load, _, alive, systems), taken = room
        newest = forces.shape[1] - 1
        s = np.int64(0)  # a literal 0 is another type, for which all would be compiled again
        for b in range(B):
            past = Past(q, v, load, memory[b], alive, systems)
            alive[0] = 1.0
            for j in range(len(q)):
                q[j], v[j] = states[b, 2 * j], states[b, 2 * j + 1]
            for u in range(forces.shape[2]):
                last = forces[b, newest, u]
                for i in range(newest):
                    forces[b, i, u] = forces[b, i + 1, u]
                forces[b, newest, u] = shaped(tables.actuators[0, u], commands[b, u], last)
            switch(tables, s, forces[b], newest, 0.0, dt, actuated[b])
            now, step = 0.0, dt
            for k in range(T):
                until = dt if k == T - 1 else (k + 1) * dt / T
                while now < until and step > 0.0:
                    event = min(next_event(tables, s, now, dt, actuated[b]), until)
                    rest = event - now
                    step = travel(
                        tables, s, past, actuated[b], rest, step, ACCURACY, w, kq, kv, tq, tv, taken
                    )
                    settle(tables, s, rest, actuated[b])
                    now = event
                    if now < dt and step > 0.0:
                        switch(tables, s, forces[b], newest, now, dt, actuated[b])
                        look(tables, s, q, v, 0, now, dt, 1, seen[b], filters[b])
                for j in range(len(q)):
                    path[k, b, 2 * j] = q[j] if step > 0.0 else np.nan
                    path[k, b, 2 * j + 1] = v[j] if step > 0.0 else np.nan
            for x in range(X):
                states[b, x] = path[T - 1, b, x]
                for i in range(seen.shape[2] - 1):
                    seen[b, x, i] = seen[b, x, i + 1]
            look(tables, s, q, v, 0, 0.0, dt, 1, seen[b], filters[b])

    return advance


_advance = _compiled(digest(*SOURCES))


class Stepper:
    """B motions of one system under commands that are not known ahead.

    What a delay, a lag or a play remembers is kept from step to step. Before its start a motion
    was in its first state for ever, and its commands were 0.
    """

    def __init__(self, tables: Tables, dt: float, batch: int, samples: int = 1) -> None:
        """Motions that start in the state 0.

        A command is held for `dt` [s]; `advance` returns T = `samples` states of one step.
        """
        self._tables, self._dt = tables, dt
        actuators, sensors = tables.actuators[0], tables.sensors[0]
        X, U = len(sensors), len(actuators)
        past = int(actuators[:, DELAY].max(initial=0.0) // dt) + 2
        future = math.ceil(sensors[:, LATENCY].max() / dt) + 2
        self.states: Float[np.ndarray, "B X"] = np.zeros((batch, X))
        """true states now"""
        self._forces = np.zeros((batch, past, U))
        self._actuated = np.zeros((batch, U, 2))
        self._seen = np.zeros((batch, X, future))
        self._filters = np.zeros((batch, X, 3))
        self._memory = np.empty((batch, len(tables.law), 2))
        self._path = np.empty((samples, batch, X))
        J = X // 2
        self._work = scratch(J), (*room_for(J, len(tables.law)), np.zeros(1, np.int64))
        self.restart(np.ones(batch, dtype=bool), self.states)

    def restart(self, which: Bool[np.ndarray, " B"], states: Float[np.ndarray, "b X"]) -> None:
        """Starts the motions marked anew, in the states given, with nothing commanded before."""
        sensors = self._tables.sensors[0]
        self.states[which] = states
        self._forces[which] = 0.0
        self._actuated[which] = 0.0
        self._memory[which] = np.nan
        seen = states.copy()
        seen[:, 0::2] -= sensors[0::2, FILTER] * states[:, 1::2]
        both = np.repeat(states.reshape(len(states), -1, 2), 2, axis=1)
        self._filters[which] = np.concatenate([both, seen[..., None]], axis=-1)
        seen += sensors[:, SINE] * np.sin(seen) + sensors[:, COSINE] * np.cos(seen)
        self._seen[which] = (sensors[:, OFFSET] + sensors[:, SCALE] * seen)[..., None]

    def advance(self, commands: Float[np.ndarray, "B U"]) -> Float[np.ndarray, "T B X"]:
        """Holds commands for dt: the true states on the way, NaN where a motion runs away."""
        _advance(
            self._tables,
            np.ascontiguousarray(commands, dtype=float),
            self._dt,
            self.states,
            self._forces,
            self._actuated,
            self._seen,
            self._filters,
            self._memory,
            self._path,
            *self._work,
        )
        return self._path.copy()

    @property
    def measured(self) -> Float[np.ndarray, "B X"]:
        """The measured states now."""
        return self._seen[:, :, 0].copy()
