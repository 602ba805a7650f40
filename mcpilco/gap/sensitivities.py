"""Simulated windows, and how they change with parameters, initial states and forces.

A learned force has many coordinates. Each changes the force all along a motion, and the motion
answers as to a train of short pulses, which are far fewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from mcpilco.bodies import distinct_rows
from mcpilco.gap.data import Windows
from mcpilco.gap.plant_model import InitialStates, PerWindow, PlantModel, Theta
from mcpilco.plant import GAIN, IDEAL_ACTUATOR, IDEAL_SENSOR, Tables, accuracy_for, design

LOST = 1e3
"""residual of a sample that a simulation that ran away did not reach, in noise std"""

START_STEPS = 1e-3, 1e-2
"""of finite differences over the initial state: positions [m or rad], velocities [m/s or rad/s]"""


def run(
    model: PlantModel,
    windows: Windows,
    theta: Float[np.ndarray, "S p"],
    x0: Float[np.ndarray, "S W X"],
) -> Float[np.ndarray, "S W X T"]:
    """Simulated measurements of S parameter vectors, each on all windows."""
    S, W = x0.shape[:2]
    theta, system = distinct_rows(theta)  # many starts of one system
    system, window = np.repeat(system, W), np.tile(np.arange(W), S)
    y = model.plant.finely(model.finer).run(
        model.tables(theta),
        system,
        np.ascontiguousarray(x0.reshape(S * W, -1)),
        window,
        np.ascontiguousarray(windows.commands),  # compiled for these alone
        windows.lead,
        windows.held_s,
        model.budget.used,
        every=windows.every,
        path=windows.before,
        accuracy=accuracy_for(windows.std),
    )
    return model.plant.beside(y.reshape(S, W, *y.shape[1:]), windows.y)


def residual(windows: Windows, y: Float[np.ndarray, "... W X T"]) -> Float[np.ndarray, "... W n"]:
    """(measured - simulated) / noise std, whitened; 0 where nothing was measured."""
    r, lost = (windows.y - y) / windows.std[:, None], ~np.isfinite(y) & windows.measured
    np.copyto(r, 0.0, where=lost | ~windows.measured)
    r, lost = (part.reshape(*y.shape[:-2], -1) for part in (r, lost))
    r = r if windows.whitening is None else windows.whitening(r)
    r[lost] = LOST
    return r


def residuals_at(
    model: PlantModel, windows: Windows, theta: Theta, x0: InitialStates
) -> Float[np.ndarray, "W n"]:
    """(measured - simulated) / noise std, whitened as the windows are."""
    return residual(windows, run(model, windows, theta[None], x0[None]))[0]


def start_nudges(X: int) -> Float[np.ndarray, " X"]:
    """Steps of finite differences over X initial states, each in its unit."""
    return np.tile(START_STEPS, X // 2)


@dataclass(frozen=True)
class Linearised:
    """A model at theta and initial states: its residuals and how they change.

    Rows of unmeasured samples are 0.
    """

    r: Float[np.ndarray, "W n"]
    """(measured - simulated) / noise std"""
    Jx: Float[np.ndarray, "W n X"]
    """change of the simulation with the initial state, over the noise std"""
    Jp: Float[np.ndarray, "W n p"]
    """with theta"""
    lost: Bool[np.ndarray, "W n"]
    """where a simulation ran away before; the columns are 0 there"""

    def __getitem__(self, chosen: Int[np.ndarray, " V"]) -> Linearised:
        """Some of the windows."""
        return Linearised(*(getattr(self, each.name)[chosen] for each in fields(self)))

    @cached_property
    def basis(self) -> Float[np.ndarray, "W n X"]:
        """Orthonormal columns that span those of Jx."""
        size = np.linalg.norm(self.Jx, axis=1, keepdims=True)
        return np.linalg.qr(self.Jx / np.where(size > 0.0, size, 1.0))[0]

    def cleaned(self, columns: Float[np.ndarray, "W n k"]) -> Float[np.ndarray, "W n k"]:
        """The part of columns that no initial state could have made."""
        return columns - self.basis @ (self.basis.transpose(0, 2, 1) @ columns)

    @cached_property
    def own(self) -> Float[np.ndarray, "W n p"]:
        """The columns of theta, cleaned."""
        return self.cleaned(self.Jp)

    def normal_equations(
        self, theta: Theta, weight: PerWindow, precision: Float[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, "p p"], Float[np.ndarray, " p"]]:
        """H and g: H step = g of the best step of theta with a prior, the initial states free."""
        P = self.own.reshape(self.r.size, len(precision))
        WP = np.repeat(weight, self.r.shape[1])[:, None] * P
        return WP.T @ P + np.diag(precision), WP.T @ self.r.ravel() - precision * theta


def linearise(
    model: PlantModel,
    windows: Windows,
    theta: Theta,
    x0: InitialStates,
    near: Linearised | None = None,
    anew: bool = False,
    over_theta: bool = True,
    sides: int = 2,
) -> Linearised:
    """The model's residuals at theta and the initial states, and their differences.

    Over theta they are central: where masses and gains grow together nothing moves, and their
    columns must cancel. Over initial states they are so where that is not dear, and `sides` is 2.
    The coordinates of learned forces are many, and their columns are made of impulse responses. Of
    a model `near` this one, with the last entries of theta less, the other columns are taken over,
    or, `anew`, only those of what a prior holds.
    """
    kept = near is not None and not anew
    X, sides = 0 if kept else x0.shape[1], 1 if model.plant.costly else sides
    there = near.Jp.shape[2] if near else 0
    known = np.arange(len(theta)) < there
    if anew:
        known &= model.held
    new = np.flatnonzero(~known[: len(theta) - model.coordinates if over_theta else 0])
    p, S = len(new), 1 + sides * X
    nudges, steps = start_nudges(X), model.steps(theta)[new]
    nudged = np.eye(X, x0.shape[1]) * nudges[:, None]
    thetas = np.tile(theta, (S + 2 * p, 1))
    moved = np.tile(x0, (S + 2 * p, 1, 1))
    moved[1:S] += np.concatenate([nudged, -nudged][:sides])[:, None]
    thetas[S + np.arange(p), new] += steps
    thetas[S + p + np.arange(p), new] -= steps
    low, high = model.bounds
    thetas = np.clip(thetas, low, high)
    y = run(model, windows, thetas, moved)
    # not where residuals are large: behind a fine encoder they are thousands of noise std
    lost = (~np.isfinite(y) & windows.measured).any(axis=0)
    r = residual(windows, np.where(lost, y[0], y))
    ups, downs = np.split(thetas[S:, new], 2)
    spans = np.diag(ups - downs).copy() if p else np.zeros(0)
    spans[spans == 0.0] = np.inf  # so large that no step changes them
    before = r[1 + X : S] if sides == 2 else r[0]
    Jx = (before - r[1 : 1 + X]) / (sides * nudges)[:, None, None]
    Jp = (r[S + p :] - r[S : S + p]) / spans[:, None, None]
    lost = lost.reshape(len(x0), -1)
    columns = Jp.transpose(1, 2, 0)
    if over_theta and model.learned:
        learned = _learned_force_columns(model, windows, theta, x0, y[0])
        learned[lost] = 0.0
        columns = np.concatenate([columns, learned], axis=2)
    Jx = Jx.transpose(1, 2, 0)
    if near:
        Jx, lost = near.Jx if kept else Jx, lost | near.lost
        columns = np.concatenate([near.Jp[:, :, known[:there]], columns], axis=2)
    if anew:
        columns = columns[:, :, np.argsort(np.append(np.flatnonzero(known), new))]
    return Linearised(r[0], Jx, columns, lost)


def lean(model: PlantModel, windows: Windows, theta: Theta, x0: InitialStates) -> Linearised:
    """The model's residuals, and one-sided differences over the initial states alone.

    They are enough for steps of the initial states, each judged by the misfit that follows.
    """
    return linearise(model, windows, theta, x0, over_theta=False, sides=1)


def motion(windows: Windows) -> Float[np.ndarray, "W T D"]:
    """Positions and speeds, as [q1, q1', q2, ...] by what was measured, and then the commands."""
    columns = []
    for j in range(windows.y.shape[1] // 2):
        q = _filled(windows.y[:, 2 * j])
        v = np.gradient(q, windows.dt, axis=1)
        columns += [q, np.apply_along_axis(np.convolve, 1, v, np.ones(3) / 3.0, mode="same")]
    return np.concatenate([np.stack(columns, axis=2), windows.driven], axis=2)


def motion_midway(model: PlantModel, theta: Theta, windows: Windows) -> Float[np.ndarray, "W m D"]:
    """States and actuator forces in the middle of each interval, on which a force may depend."""
    at = motion(windows)
    U = windows.commands.shape[2]
    gains = model.tables(theta[None]).actuators[0, :, GAIN]
    middle = 0.5 * (at[:, :-1] + at[:, 1:])
    middle[:, :, -U:] = gains * at[:, :-1, -U:]  # a command is held
    return middle


def _filled(q: Float[np.ndarray, "W T"]) -> Float[np.ndarray, "W T"]:
    """Positions, the missing ones interpolated."""
    filled, t = q.copy(), np.arange(q.shape[1])
    for row in filled:
        known = np.isfinite(row)
        row[:] = np.interp(t, t[known], row[known]) if known.any() else 0.0
    return filled


SIZE = 1e-2
"""of a pulse, in usual forces of its joint"""

HELD = 2
"""samples for which a pulse is held that stands for a learned force"""


def impulse_responses(
    model: PlantModel,
    windows: Windows,
    theta: Theta,
    x0: InitialStates,
    joints: Sequence[int],
    hold: int,
    unstuck: bool = False,
) -> list[Float[np.ndarray, "W n K"]]:
    """Change of the measurements, in noise std, per unit force in each joint, by interval.

    Each pulse is simulated from where it begins: nothing changes before.

    Args:
        model: what is simulated.
        windows: the motions.
        theta: of the model.
        x0: initial states of the windows.
        joints: their numbers.
        hold: samples for which a pulse is held; K of them follow one another.
        unstuck: whether a joint that sticks answers as if it moved, as on the machine it may.
    """
    (W, X, T), every, lead, J = windows.y.shape, windows.every, windows.lead, len(joints)
    tables, plant = model.tables(theta[None]), model.plant.finely(model.finer)
    added = np.tile(np.array(IDEAL_ACTUATOR), (len(tables.actuators), J, 1))  # one a joint
    actuators = np.concatenate([tables.actuators, added], axis=1)
    tables = tables._replace(drives=np.append(tables.drives, joints), actuators=actuators)
    commands = np.pad(windows.commands, ((0, 0), (0, 0), (0, J)))

    def moved(tables: Tables, first: int, start: np.ndarray, pulses: np.ndarray) -> np.ndarray:
        """The measurements from a sample on, with each of some pulses there.

        Motions of a window follow one another, for they take the same steps.
        """
        many = len(pulses)
        each = np.repeat(commands[:, first * every :], many, axis=0)
        each[:, lead : lead + hold * every, each.shape[2] - J :] = np.tile(pulses, (W, 1))[:, None]
        y = plant.run(
            tables,
            np.zeros(len(each), dtype=np.int64),
            np.repeat(start, many, axis=0),
            np.arange(len(each)),
            each,
            lead,
            windows.held_s,
            model.budget.used,
            every=every,
            path=np.repeat(windows.path[:, first * every :][:, : lead + 1], many, axis=0),
            accuracy=accuracy_for(windows.std),
        )
        return y.reshape(W, many, X, -1).swapaxes(0, 1)

    ideal = tables._replace(sensors=np.tile(np.array(IDEAL_SENSOR), (1, X, 1)))
    states = moved(ideal, 0, x0, np.zeros((1, J)))[0]
    if unstuck:
        loose = model.tables(model.softened(theta, unstuck=True)[None])
        tables = loose._replace(drives=tables.drives, actuators=tables.actuators)
    sizes = SIZE * np.array([model.scales[plant.layout.joints[joint]].force for joint in joints])
    starts = range(0, T - 1, hold)
    change = np.zeros((J, W, X, T, len(starts)))
    for k, first in enumerate(starts):
        both = np.diag(sizes)
        ups, downs = np.split(
            moved(tables, first, states[:, :, first], np.append(both, -both, 0)), 2
        )
        change[..., first:, k] = (ups - downs) / (2.0 * sizes[:, None, None, None])
    change *= windows.measured[..., None] / windows.std[:, None, None]
    return list(np.nan_to_num(change, posinf=0.0, neginf=0.0).reshape(J, W, X * T, -1))


def _learned_force_columns(
    model: PlantModel,
    windows: Windows,
    theta: Theta,
    x0: InitialStates,
    y: Float[np.ndarray, "W X T"],
) -> Float[np.ndarray, "W n R"]:
    """Change of the measurements, in noise std, with the coordinates of the learned forces.

    A coordinate changes the force all along a motion, and the motion answers as to a train of
    pulses. These are far fewer than coordinates. `y` are simulated measurements.
    """
    layout = model.plant.layout
    names = (*layout.states, *layout.inputs)
    midway = motion_midway(model, theta, replace(windows, y=np.where(np.isfinite(y), y, np.nan)))
    W, m, _ = midway.shape
    first = np.arange(0, m, HELD)
    lengths = np.diff(np.append(first, m))[:, None]
    joints = sorted({layout.joints.index(force.joint) for force in model.learned})
    G = dict(zip(joints, impulse_responses(model, windows, theta, x0, joints, HELD), strict=True))
    columns = []
    for force in model.learned:
        x = [midway[:, :, names.index(axis.of)].ravel() for axis in force.axes]
        unit = (design(force.axes, x) @ force.basis).reshape(W, m, -1)
        mean = np.add.reduceat(unit, first, axis=1) / lengths
        columns.append(G[layout.joints.index(force.joint)] @ mean)
    return np.concatenate(columns, axis=2)
