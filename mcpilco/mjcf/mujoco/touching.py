"""Where a recorded machine touches something, or runs into the ends of its joints.

Equations of motion have neither: they hold in between.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import find_objects, label

from mcpilco.mjcf.models import load_mjcf


def spans_touching(
    path: str | Path,
    time: Float[np.ndarray, " T"],
    positions: Mapping[str, Float[np.ndarray, " T"]],
) -> tuple[tuple[float, float], ...]:
    """Spans of a recording in which a joint is at an end of its range, or bodies touch [s].

    It is so where MuJoCo has a contact or a limit at the positions of a sample, or at those where
    the joints would have been a sample before or after, at the speed at which they come or go. A
    joint that was not recorded stays where the model is drawn.

    Args:
        path: of the file of a model of hinges and slides.
        time: of the samples [s].
        positions: recorded ones, by the names of joints [rad or m].

    Raises:
        InputError: MuJoCo cannot load the file.
    """
    model = load_mjcf(Path(path), "the model of what touches must be an MJCF or a URDF file")
    names = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
    qpos = np.tile(model.qpos0, (len(time), 1))
    for at, name in zip(model.jnt_qposadr, names, strict=True):
        qpos[:, at] = positions.get(name, qpos[:, at])
    there = np.zeros(len(time), dtype=bool)
    here = qpos[1:-1]
    for poses in (here, 2.0 * here - qpos[2:], 2.0 * here - qpos[:-2]):
        there[1:-1] |= _touches(model, poses)
    own, t = [span for (span,) in find_objects(label(there)[0])], time - time[0]
    return tuple((float(t[max(s.start - 1, 0)]), float(t[min(s.stop, len(t) - 1)])) for s in own)


def _touches(model: mujoco.MjModel, poses: Float[np.ndarray, "T nq"]) -> Bool[np.ndarray, " T"]:
    data, found = mujoco.MjData(model), np.zeros(len(poses), dtype=bool)
    limit = int(mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT)
    for k in np.flatnonzero(np.isfinite(poses).all(axis=1)):
        data.qpos[:] = poses[k]
        mujoco.mj_fwdPosition(model, data)
        found[k] = data.ncon > 0 or (data.efc_type == limit).any()
    return found
