"""How measurements answer to small forces in a joint, and so to a learned force that changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from mcpilco.gap.model import Model
from mcpilco.gap.moves import moves_of
from mcpilco.gap.windows import Windows
from mcpilco.plant import IDEAL_ACTUATOR, Tables, design, simulate

SIZE = 1e-2
"""of a push, in usual forces of its joint"""
HELD = 2
"""samples for which a push is held that stands for a learned force"""


def answers(
    model: Model,
    windows: Windows,
    theta: Float[np.ndarray, " p"],
    starts: Float[np.ndarray, "W X"],
    joint: int,
    hold: int,
) -> Float[np.ndarray, "W n K"]:
    """Change of the measurements, in noise std, per unit force in a joint, by interval.

    Args:
        model: what is pushed.
        windows: the motions.
        theta: of the model.
        starts: of the windows.
        joint: number of the joint.
        hold: samples for which a push is held; K of them follow one another.
    """
    size = SIZE * model.scales[model.plant.layout.joints[joint]].force
    tables = _pushed(model.tables(theta[None]), joint)
    W, T_all, U = windows.commands.shape
    first = np.arange(0, windows.y.shape[2] - 1, hold)
    K = len(first)
    each = np.zeros(2 * K, dtype=np.int64)
    changes = np.empty((W, windows.y[0].size, K))
    for w in range(W):
        commands = np.zeros((2 * K, T_all, U + 1))
        commands[:, :, :U] = windows.commands[w]
        for k, start in enumerate(windows.lead + first):
            commands[2 * k, start : start + hold, U] = size
            commands[2 * k + 1, start : start + hold, U] = -size
        y = simulate(
            tables,
            each,
            np.tile(starts[w], (2 * K, 1)),
            np.arange(2 * K),
            commands,
            windows.lead,
            windows.dt,
            model.effort.taken,
        )
        change = (y[0::2] - y[1::2]) / (2.0 * size) / windows.std[:, None]
        change = np.where(np.isfinite(change) & windows.measured[w], change, 0.0)
        changes[w] = change.reshape(K, -1).T
    return changes


def _pushed(tables: Tables, joint: int) -> Tables:
    """The system with one input more, which pushes a joint."""
    ideal = np.tile(np.array(IDEAL_ACTUATOR), (len(tables.actuators), 1, 1))
    return tables._replace(
        drives=np.append(tables.drives, joint),
        actuators=np.concatenate([tables.actuators, ideal], axis=1),
    )


def learned_columns(
    model: Model,
    windows: Windows,
    theta: Float[np.ndarray, " p"],
    starts: Float[np.ndarray, "W X"],
    y: Float[np.ndarray, "W X T"],
) -> Float[np.ndarray, "W n R"]:
    """Change of the measurements, in noise std, with the coordinates of the learned forces.

    A coordinate changes the force all along a motion, and the motion answers as to a train of
    pushes. These are far fewer than coordinates.

    Args:
        model: with learned forces.
        windows: the motions.
        theta: of the model.
        starts: of the windows.
        y: what the model says is measured.
    """
    layout = model.plant.layout
    names = (*layout.states, *layout.inputs)
    moves = moves_of(model, theta, replace(windows, y=np.where(np.isfinite(y), y, np.nan)))
    W, m, _ = moves.shape
    first = np.arange(0, m, HELD)
    lengths = np.diff(np.append(first, m))[:, None]
    joints = {layout.joints.index(force.joint) for force in model.learned}
    G = {j: answers(model, windows, theta, starts, j, HELD) for j in joints}
    columns = []
    for force in model.learned:
        x = [moves[:, :, names.index(axis.of)].ravel() for axis in force.axes]
        unit = (design(force.axes, x) @ force.basis).reshape(W, m, -1)
        mean = np.add.reduceat(unit, first, axis=1) / lengths
        columns.append(G[layout.joints.index(force.joint)] @ mean)
    return np.concatenate(columns, axis=2)
