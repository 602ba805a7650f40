"""MuJoCo models as scenes of shapes in 3D and as pictures, which need no window or display."""

from __future__ import annotations

import atexit
import importlib
import math
import os
import sys
import weakref
from collections.abc import Mapping
from typing import Any, Literal

import mujoco
import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from envs.drawing import HEIGHT, INPUT_COLOR, WIDTH
from mcpilco.show import Pose, Scene, Shape
from mcpilco.typing import EnvError

_KINDS: dict[mujoco.mjtGeom, tuple[Literal["box", "capsule", "sphere"], tuple[int, ...]]] = {
    mujoco.mjtGeom.mjGEOM_SPHERE: ("sphere", (0,)),
    mujoco.mjtGeom.mjGEOM_CAPSULE: ("capsule", (0, 1)),
    mujoco.mjtGeom.mjGEOM_CYLINDER: ("capsule", (0, 1)),
    mujoco.mjtGeom.mjGEOM_BOX: ("box", (0, 1, 2)),
}
"""kind of geom -> kind of shape, and which of the geom's sizes it takes; a cylinder's ends are
rounded off, other kinds are left out"""
_DRAWN_GROUPS = 3
"""MuJoCo's viewers show the groups of geoms below this one"""

# lengths in those of the pole, as for the analytic cart-pole [-]
_DISTANCE = 3.6
_MARGIN = 1.6
_ARROW = 1.0  # of which MuJoCo draws half
_ARROW_RADIUS = 0.03
_ELEVATION = -12.0
"""of the camera [deg]"""


class Posture:
    """Where the parts of a model are, as a function of its joints' positions."""

    def __init__(self, model: mujoco.MjModel, joints: tuple[str, ...], tip: str) -> None:
        """The posture of a model.

        A state holds position and velocity of the joints, in their order. Where there is no site
        `tip` to mark it by, that is the centre of mass of the last joint's body.
        """
        self.model = model
        self._data = mujoco.MjData(model)
        self._addresses = [int(model.joint(name).qposadr[0]) for name in joints]
        self._site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tip)
        self._last = int(model.joint(joints[-1]).bodyid[0])

    def at(self, state: Float[np.ndarray, " X"]) -> mujoco.MjData:
        """The model in a state, good until the next call."""
        self._data.qpos[self._addresses] = state[0::2]
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_comPos(self.model, self._data)
        mujoco.mj_camlight(self.model, self._data)
        return self._data

    def marker(self, states: Float[np.ndarray, "*b X"]) -> Float[np.ndarray, "*b 3"]:
        """The point that stands for a state [m]."""
        points = np.empty((*states.shape[:-1], 3))
        for index in np.ndindex(*states.shape[:-1]):
            data = self.at(states[index])
            points[index] = data.xipos[self._last] if self._site < 0 else data.site_xpos[self._site]
        return points

    def hinge(self, state: Float[np.ndarray, " X"]) -> Float[np.ndarray, " 3"]:
        """Where the last joint's body begins [m]."""
        return self.at(state).xpos[self._last].copy()


def scene(posture: Posture, target: Float[np.ndarray, " X"]) -> Scene:
    """The model in 3D: the geoms that MuJoCo's own viewer shows, as far as they are simple."""
    model = posture.model
    shapes = {_name(model, i): _shape(model, i) for i in range(model.ngeom) if _drawn(model, i)}

    def poses(states: Float[np.ndarray, "T X"]) -> Mapping[str, Pose]:
        positions = np.empty((len(states), model.ngeom, 3))
        rotations = np.empty((len(states), model.ngeom, 3, 3))
        for k, state in enumerate(states):
            data = posture.at(state)
            positions[k], rotations[k] = data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3)
        return {
            _name(model, i): Pose(positions[:, i], Rotation.from_matrix(rotations[:, i]).as_quat())
            for i in range(model.ngeom)
            if _drawn(model, i)
        }

    x, y, z = posture.marker(target).tolist()
    return Scene(shapes=shapes, poses=poses, marker=posture.marker, target=(x, y, z))


class ModelPicture:
    """Draws any model in a state, from where its file says that it is looked at."""

    def __init__(self, posture: Posture) -> None:
        """A picture that opens OpenGL when it first draws."""
        self._posture = posture
        self._scene = mujoco.MjvScene(posture.model, maxgeom=posture.model.ngeom + 1000)
        self._camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(posture.model, self._camera)
        self._offscreen: Offscreen | None = None

    def __call__(
        self, state: Float[np.ndarray, " X"], push: float = 0.0
    ) -> UInt8[np.ndarray, "H W 3"]:
        """The picture.

        The push is relative to its limit, in [-1, 1]; only some pictures show it.

        Raises:
            EnvError: there is no OpenGL here.
        """
        if self._offscreen is None:
            self._offscreen = Offscreen(self._posture.model, WIDTH, HEIGHT)
        self._place(state, push)
        return self._offscreen.draw(self._scene)

    def close(self) -> None:
        """Gives OpenGL back."""
        if self._offscreen is not None:
            self._offscreen.close()
            self._offscreen = None

    def _place(self, state: Float[np.ndarray, " X"], push: float) -> None:
        """Puts the model in a state into the scene."""
        everything = mujoco.mjtCatBit.mjCAT_ALL.value
        looked = self._posture.at(state), mujoco.MjvOption(), None, self._camera, everything
        mujoco.mjv_updateScene(self._posture.model, *looked, self._scene)


class MujocoPicture(ModelPicture):
    """Draws a model in a state from the side, with the force on its first body."""

    def __init__(self, posture: Posture) -> None:
        """A picture that opens OpenGL when it first draws."""
        super().__init__(posture)
        rest = np.zeros(2 * posture.model.njnt)
        along = posture.marker(rest) - posture.hinge(rest)
        self._length = float(np.hypot(along[0], along[2]))
        self._camera.azimuth, self._camera.elevation = 90.0, _ELEVATION
        self._camera.distance = _DISTANCE * self._length

    def _place(self, state: Float[np.ndarray, " X"], push: float) -> None:
        hinge = self._posture.hinge(state)
        x, most = float(hinge[0]), _MARGIN * self._length
        self._camera.lookat = [x - min(max(x, -most), most), *hinge[1:]]
        super()._place(state, push)
        if push:
            self._add_arrow(hinge, push)

    def _add_arrow(self, hinge: Float[np.ndarray, " 3"], push: float) -> None:
        """Puts the force into the scene, in front of the hinge."""
        length = self._length
        size = length * np.array([_ARROW_RADIUS, _ARROW_RADIUS, _ARROW * abs(push)])
        start = hinge + length * np.array([math.copysign(0.3, push), -0.2, 0.0])
        # an arrow points along z, which is turned to x here, or to -x
        turn = Rotation.from_euler("y", math.copysign(90.0, push), degrees=True).as_matrix()
        color = np.array([*INPUT_COLOR, 255], dtype=np.float32) / 255.0
        mujoco.mjv_initGeom(
            self._scene.geoms[self._scene.ngeom],
            mujoco.mjtGeom.mjGEOM_ARROW.value,
            size,
            start,
            turn.ravel(),
            color,
        )
        self._scene.ngeom += 1


def _drawn(model: mujoco.MjModel, i: int) -> bool:
    """Whether a geom is visible, and of a kind that a scene has."""
    visible = model.geom_group[i] < _DRAWN_GROUPS and model.geom_rgba[i, 3] > 0
    return bool(visible) and mujoco.mjtGeom(model.geom_type[i]) in _KINDS


def _name(model: mujoco.MjModel, i: int) -> str:
    return model.geom(i).name or f"geom_{i}"


def _shape(model: mujoco.MjModel, i: int) -> Shape:
    kind, sizes = _KINDS[mujoco.mjtGeom(model.geom_type[i])]
    material = model.geom_matid[i]
    rgba = model.geom_rgba[i] if material < 0 else model.mat_rgba[material]
    red, green, blue = np.rint(255 * rgba[:3]).astype(int).tolist()
    return Shape(kind, tuple(model.geom_size[i, list(sizes)].tolist()), (red, green, blue))


REMEDY = (
    "install EGL (Debian: apt-get install libegl1 libgl1-mesa-dri), or OSMesa (apt-get install "
    "libosmesa6) and set MUJOCO_GL=osmesa"
)
"""what to do where nothing draws"""


class Offscreen:
    """Draws scenes of one model into arrays.

    `mujoco.Renderer` takes the OpenGL backend that the variable MUJOCO_GL named when MuJoCo was
    imported, and without one needs a display; this class chooses when it is made.
    """

    def __init__(self, model: mujoco.MjModel, width: int, height: int) -> None:
        """An OpenGL context with the model's meshes and textures.

        Raises:
            EnvError: there is no OpenGL here; the sentence says what to install.
        """
        self._rect = mujoco.MjrRect(0, 0, width, height)
        visual = model.vis.global_
        visual.offwidth = max(width, visual.offwidth)
        visual.offheight = max(height, visual.offheight)
        self._gl, self._context = _open(model, width, height)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        _OPEN.add(self)
        # what is registered last is called first: before the backend ends, which it registered
        atexit.unregister(_close_all)
        atexit.register(_close_all)

    def draw(self, scene: mujoco.MjvScene) -> UInt8[np.ndarray, "H W 3"]:
        """A picture of the scene."""
        self._gl.make_current()
        mujoco.mjr_render(self._rect, scene, self._context)
        image = np.empty((self._rect.height, self._rect.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(image, None, self._rect, self._context)
        return image[::-1]  # OpenGL counts rows from below

    def close(self) -> None:
        """Gives the context back; nothing can be drawn any more."""
        _OPEN.discard(self)
        self._gl.make_current()
        self._context.free()
        self._gl.free()


_OPEN: weakref.WeakSet[Offscreen] = weakref.WeakSet()
"""those that can draw"""


def _close_all() -> None:
    for offscreen in list(_OPEN):
        offscreen.close()


def backends() -> list[str]:
    """The modules of MuJoCo that may open a context here, the one to try first in front."""
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    if asked in ("egl", "osmesa", "glfw"):
        return [asked]
    if sys.platform != "linux":
        return ["cgl", "glfw"] if sys.platform == "darwin" else ["glfw"]
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return ["egl", "glfw"] if display else ["egl"]


def _open(model: mujoco.MjModel, width: int, height: int) -> tuple[Any, mujoco.MjrContext]:
    """The first context that opens."""
    reasons = []
    for name in backends():
        try:
            gl = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
            gl.make_current()
            return gl, mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        except Exception as error:  # a missing library shows as an error of any class
            words = " ".join(str(error).split()) or type(error).__name__
            reasons.append(f"{name} says: {words.rstrip('.')}")
    raise EnvError(f"No OpenGL draws MuJoCo's pictures here ({'; '.join(reasons)}): {REMEDY}.")
