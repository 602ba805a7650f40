"""The picture of a plant that MuJoCo simulates: the model's own geoms."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from mcpilco.mjcf import MujocoPlant
from mcpilco.plant import ChainPlant, Plant
from mcpilco.show.scene import Pose, Scene, Shape, chain_scene
from mcpilco.typing import InputError

_KINDS = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE): "sphere",
    int(mujoco.mjtGeom.mjGEOM_CAPSULE): "capsule",
    int(mujoco.mjtGeom.mjGEOM_CYLINDER): "capsule",
}
"""all others are drawn as the boxes around them"""


def scene_of(plant: Plant) -> Scene:
    """The picture of a plant of either kind.

    Raises:
        InputError: its kind has no picture.
    """
    if isinstance(plant, MujocoPlant):
        return _drawn(plant)
    if not isinstance(plant, ChainPlant):
        raise InputError(f"there is no picture of {plant.name}: its kind is unknown.")
    return chain_scene(plant.chain)


def _drawn(plant: MujocoPlant) -> Scene:
    """The geoms that move; the marker is the center of mass of all of them."""
    model, data = plant.model, mujoco.MjData(plant.model)
    moving = [int(g) for g in np.flatnonzero(model.body_weldid[model.geom_bodyid] != 0)]
    names = {g: model.geom(g).name or f"geom{g}" for g in moving}

    def shape(g: int) -> Shape:
        kind = _KINDS.get(int(model.geom_type[g]), "box")
        color = tuple(int(255 * part) for part in model.geom_rgba[g, :3])
        size = model.geom_aabb[g, 3:] if kind == "box" else model.geom_size[g]
        count = {"box": 3, "capsule": 2, "sphere": 1}[kind]
        return Shape(kind, tuple(map(float, size[:count])), color)  # type: ignore[arg-type]

    def moved(states: Float[np.ndarray, "T X"]):
        for qpos in plant.coordinates.qpos(np.nan_to_num(states[:, 0::2])):
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            yield data

    def poses(states: Float[np.ndarray, "T X"]) -> Mapping[str, Pose]:
        found = [(d.geom_xpos[moving].copy(), d.geom_xmat[moving].copy()) for d in moved(states)]
        at, turned = (np.array(part) for part in zip(*found, strict=True))
        return {
            names[g]: Pose(at[:, n], Rotation.from_matrix(turned[:, n].reshape(-1, 3, 3)).as_quat())
            for n, g in enumerate(moving)
        }

    def marker(states: Float[np.ndarray, "*b X"]) -> Float[np.ndarray, "*b 3"]:
        flat = states.reshape(-1, states.shape[-1])
        return np.array([d.subtree_com[0] for d in moved(flat)]).reshape(*states.shape[:-1], 3)

    return Scene(shapes={names[g]: shape(g) for g in moving}, poses=poses, marker=marker)
