"""Pictures of a MuJoCo scene without a window, and without a display where EGL is there."""

from __future__ import annotations

import atexit
import importlib
import os
import sys
import weakref
from typing import Any

import mujoco
import numpy as np
from jaxtyping import UInt8

from mcpilco.typing import EnvError

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

        Args:
            model: what is drawn.
            width: of a picture [pixel].
            height: of a picture [pixel].

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
