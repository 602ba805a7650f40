"""The picture of an environment in 3D: shapes, and where they are in each state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Shape:
    """One rigid body, drawn as a box, a capsule or a sphere, centred at its own origin."""

    kind: Literal["box", "capsule", "sphere"]
    size: tuple[float, ...]
    """box: half lengths along x, y, z; capsule: radius, half length along z; sphere: radius [m]"""
    color: tuple[int, int, int]
    """red, green, blue in 0..255"""


@dataclass(frozen=True)
class Pose:
    """Where one body is, for each of T states."""

    translation: Float[np.ndarray, "T 3"]
    """centre [m]"""
    quaternion: Float[np.ndarray, "T 4"]
    """rotation of the body into the world, order x, y, z, w [-]"""


@dataclass(frozen=True)
class Scene:
    """An environment's picture. `z` points up."""

    shapes: Mapping[str, Shape]
    """bodies that move, by name"""
    poses: Callable[[Float[np.ndarray, "T X"]], Mapping[str, Pose]]
    """the pose of every body for each state"""
    marker: Callable[[Float[np.ndarray, "*b X"]], Float[np.ndarray, "*b 3"]]
    """one point that stands for a state, such as a pole's tip; particles are drawn by it [m]"""
    fixed: tuple[tuple[Shape, tuple[float, float, float]], ...] = ()
    """bodies that never move, and where they are [m]"""
    target: tuple[float, float, float] | None = None
    """where the marker should go [m]"""
