"""Where recordings run into the ends of a model's joints, which equations of motion do not have."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.ndimage import find_objects, label

from mcpilco.mjcf.models import load_mjcf


def spans_at_ends(
    path: str | Path,
    time: Float[np.ndarray, " T"],
    positions: Mapping[str, Float[np.ndarray, " T"]],
) -> tuple[tuple[float, float], ...]:
    """Spans of a recording in which a hinge or a slide is at an end of its range [s].

    MuJoCo's joints are stopped there, those of `plant_of` are not. A joint counts as being there
    as well where it would have been within a sample, at the speed at which it goes or comes.

    Args:
        path: of the model's file.
        time: of the samples [s].
        positions: recorded ones, by the names of joints [rad or m].

    Raises:
        InputError: MuJoCo cannot load the file.
    """
    model = load_mjcf(Path(path), "the model of joints with ends must be an MJCF or a URDF file")
    kinds = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    there = np.zeros(len(time), dtype=bool)
    for j in np.flatnonzero(model.jnt_limited.astype(bool) & np.isin(model.jnt_type, kinds)):
        q = positions.get(model.joint(j).name or f"joint{j}")
        if q is not None:
            low, high = model.jnt_range[j]
            before, after = 2.0 * q[1:-1] - q[2:], 2.0 * q[1:-1] - q[:-2]
            every = np.stack([q[1:-1], before, after])
            there[1:-1] |= ((every < low) | (every > high)).any(axis=0)
    own = [span for (span,) in find_objects(label(there)[0])]
    t = time - time[0]
    return tuple((float(t[max(s.start - 1, 0)]), float(t[min(s.stop, len(t) - 1)])) for s in own)
